"""What the steps of an output hide: means of data sets whose noise does not carry the output over a step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.examine import Examination, block_curve
from gyrocal.diagnosis.names import Named
from gyrocal.diagnosis.parts import BLOCKS
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.series import Raw

Floats = NDArray[np.float64]


def rounding_dps(raw: Raw) -> float:
    """How far the mean of many rounded samples may be off, deg/s: the first harmonic of the steps that noise leaves.

    The scatter of the samples has a twelfth of the square of a step in it, which is none of the noise's.
    """
    step, scatter = raw.lattice_dps, raw.sample_std_dps
    if step is None or scatter is None:
        return 0.0
    noise_steps2 = max((scatter / step) ** 2 - 1.0 / 12.0, 0.0)
    return float(step / np.pi * np.exp(-2.0 * np.pi**2 * noise_steps2))


def beyond_rounding(found: Examination) -> tuple[Examination, list[Remark]]:
    """What was found in a run, less laws and smooth parts that rounding may make; and the remark that says so.

    Rounding is one error for each output, whatever that depends on: it can follow any law that is smaller than itself.
    """
    bound = 0.0 if found.ranked else rounding_dps(found.series.raw)
    fitted = found.naming.fitted
    solution, model = fitted.solve(), fitted.model

    def beneath(curve_dps: Floats) -> bool:
        return bool(0.5 * np.ptp(curve_dps) < bound)

    blocks = {b for b in found.naming.unnamed if beneath(block_curve(fitted, solution, b))}
    kept: list[Named] = []
    gone: list[Named] = []
    for n in found.naming.named:
        amplitudes = solution.amplitudes.get(n.law.name)
        own = block_curve(fitted, solution, n.block) if amplitudes is None else n.law.columns @ amplitudes
        (gone if beneath(own) else kept).append(n)
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
