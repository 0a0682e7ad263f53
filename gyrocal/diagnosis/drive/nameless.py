"""What has no name: structure over a coordinate that no law makes, and what it leaves of the laws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gyrocal.diagnosis.drive.jumps import chance
from gyrocal.diagnosis.drive.laws import KINDS, Law
from gyrocal.diagnosis.drive.levels import STRANGER_P
from gyrocal.diagnosis.drive.weighing import Evidence

Floats = NDArray[np.float64]


def is_odd(log_p: float) -> bool:
    """Whether a coordinate is odd, by the logarithm of its p-value, which may be less than a float holds."""
    return bool(np.exp(log_p) < STRANGER_P)


class GainTest(NamedTuple):
    """What columns gain (twice the log likelihood), how many they are, and the chance of that where there is nothing."""

    gain: float
    columns: int
    p_value: float

    @classmethod
    def of(cls, gain: float, columns: int = 1) -> GainTest:
        """The test of columns that nobody chose among others."""
        return cls(gain, columns, float(stats.chi2.sf(gain, columns)))


def nameless(
    free: Evidence, chosen: Sequence[str], jumping: Mapping[str, Law], blocks: Mapping[str, Floats]
) -> tuple[dict[str, GainTest], dict[str, Law]]:
    """What is over each coordinate beside the laws, and what of the wheels changes at one instant, if nothing else does."""
    changed = {n: x for n, x in jumping.items() if n not in KINDS}
    odd = {c: _without_name(free, [*chosen, *changed], f"{c}:", block) for c, block in blocks.items()}
    at_once = "time" not in odd or odd["time"].p_value >= STRANGER_P
    gains = [free.added(chosen, [name]) for name in changed]
    odd = odder(odd, "time", *(GainTest(gain, 1, chance(gain)) for gain in gains))
    return odd, changed if at_once else {}


def unhidden(told: Evidence, fitted: Sequence[str], changed: Mapping[str, Law]) -> dict[str, Law]:
    """Changes of the wheels that are sure beside all else that is fitted: what else has no name may have looked like one."""
    gains = {n: told.added([other for other in fitted if other != n], [n]) for n in changed}
    return {n: law for n, law in changed.items() if chance(gains[n]) < STRANGER_P}


def _without_name(free: Evidence, chosen: Sequence[str], prefix: str, block: Floats) -> GainTest:
    """Whether there is something over a coordinate.

    Against laws that are free: a robot file that grants too little of them is no structure without a name.
    """
    names = [f"{prefix}{k}" for k in range(block.shape[1])]
    return GainTest.of(free.added(chosen, names), len(names))


def odder(odd: Mapping[str, GainTest], coordinate: str, *tests: GainTest) -> dict[str, GainTest]:
    """Tests by coordinate with some more, of which the surest counts."""
    found = [*tests, *(test for c, test in odd.items() if c == coordinate)]
    return {**odd, coordinate: min(found, key=lambda one: one.p_value)} if found else dict(odd)


def beside_means(
    free: Evidence,
    columns: Mapping[str, Floats],
    chosen: Sequence[str],
    beside: Sequence[str],
    jumping: Mapping[str, Law],
) -> tuple[Evidence, dict[str, Floats]]:
    """Tests and columns without a name, these less what laws of the wheels could be of them.

    A bias that is weighed beside them is known no better than they leave it, while track and wheels keep their mean over the
    drive: beside the bare columns of the speed they would be those of the slowest part. Where the wheels change at an
    instant they keep what they are after it.
    """
    wheels = [n for n in chosen if not KINDS[n].figure]
    lasting = [n for n in beside if n not in jumping]
    if not lasting:
        return free, {n: columns[n] for n in beside}
    shares = np.stack([free.own.nearest(n, wheels) for n in lasting], axis=1)
    means = np.stack([columns[n] for n in wheels], axis=1) @ shares
    apart = {n: columns[n] - mean for n, mean in zip(lasting, means.T, strict=True)}
    return free.less(lasting, wheels, shares), {n: apart.get(n, columns[n]) for n in beside}
