"""What the steps of an output hide: where the noise is smaller than a step, means of data sets are off by rounding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.examine import Examination, block_curve
from gyrocal.diagnosis.laws.in_place import Named
from gyrocal.diagnosis.model.parts import BLOCKS
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.units import NORMAL_95

Floats = NDArray[np.float64]


def beyond_rounding(found: Examination) -> tuple[Examination, list[Remark]]:
    """What was found in a run, less laws and smooth parts that rounding may make; and the remark that says so.

    Rounding is one error for each output, whatever that depends on: it can follow any law that is not surely larger than itself.
    """
    fitted = found.naming.fitted
    model = fitted.model
    bound = 0.0 if found.ranked else found.series.raw.rounding_dps
    if bound**2 * len(model.means) < fitted.fit.variance["white"]:
        # What all data sets together would not show takes nothing from anybody.
        return found, []
    solution = fitted.solve()

    def beneath(curve_dps: Floats, surely: float = 1.0) -> bool:
        return bool(0.5 * np.ptp(curve_dps) * surely < bound)

    def beneath_law(n: Named) -> bool:
        amplitudes = solution.amplitudes.get(n.law.name)
        if amplitudes is None:
            return beneath(block_curve(fitted, solution, n.block))
        at = solution.starts[n.law.name] + int(np.argmax(np.abs(amplitudes)))
        std, size = np.sqrt(solution.covariance[at, at]), np.max(np.abs(amplitudes))
        return beneath(n.law.columns @ amplitudes, max(1.0 - NORMAL_95 * std / size, 0.0))

    blocks = {b for b in found.naming.unnamed if beneath(block_curve(fitted, solution, b))}
    kept: list[Named] = []
    gone: list[Named] = []
    for n in found.naming.named:
        (gone if beneath_law(n) else kept).append(n)
    patterns = tuple(p for p in found.patterns if not beneath(p.values))
    if not (blocks or gone) and len(patterns) == len(found.patterns):
        return found, []
    # What passes stays in the model: rounding is noise to the rest.
    smooth = [n for n, b in model.blocks.items() if b in blocks and BLOCKS[b].stays]
    fewer = model.without(smooth).without_laws([n.law.name for n in gone])
    unnamed = {b: nats for b, nats in found.naming.unnamed.items() if b not in blocks}
    naming = replace(found.naming, fitted=fitted.refit(fewer), named=tuple(kept), unnamed=unnamed)
    return replace(found, patterns=patterns, naming=naming), [
        Remark(Said.LOST_IN_STEPS, {"hidden_mdps": 1e3 * bound})
    ]
