"""A wheel out of true: a line in the spectrum of the heading difference over the distance of one wheel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from gyrocal.diagnosis.drive.laws import Frame, Law, wheel_laws
from gyrocal.diagnosis.drive.weighing import gram_of
from gyrocal.diagnosis.drive.yaw import YawModel

Floats = NDArray[np.float64]

#: Twice the log likelihood that a wheel out of true must gain to be named: the best of many radii.
WHEEL_GAIN = 38.0
#: Radii of wheels, m, and how many peaks of each side's spectrum are looked at.
_RADII_M, _PEAKS = (0.02, 0.6), 3


def wheel_out_of_true(
    frame: Frame,
    model: YawModel,
    laws: Mapping[str, Law],
    chosen: Sequence[str],
    known: Mapping[str, tuple[float, float]],
) -> dict[str, Law]:
    """The wheel out of true that fits best, if it clears its limit; its law as cosine and sine."""
    if not frame.series.differential:
        return {}
    columns = np.column_stack([*(laws[n].column for n in chosen), model.y])
    weighed = model.given(columns).inverse()
    gram = columns[:, :-1].T @ weighed
    score = weighed[:, -1] - weighed[:, :-1] @ np.linalg.lstsq(gram[:, :-1], gram[:, -1], rcond=None)[0]
    cases = [(side, r) for side in (-1.0, 1.0) for r in _radii(frame, score, side)]
    best: tuple[float, dict[str, Law]] = (WHEEL_GAIN, {})
    for side, radius in cases:
        for near in radius * (1.0 + np.array([-0.5, 0.0, 0.5]) * _resolution(frame, side, radius)):
            pair = dict(zip(("wheel_cos", "wheel_sin"), wheel_laws(frame, side, float(near)), strict=True))
            tried = {n: laws[n].column for n in chosen} | {n: x.column for n, x in pair.items()}
            gain = gram_of(model, tried).knowing(known).added(chosen, list(pair))
            if gain > best[0]:
                best = (gain, pair)
    return best[1]


def _resolution(frame: Frame, side: float, radius_m: float) -> float:
    """Relative change of the radius that shifts a wheel's angle by half a turn over the drive."""
    wheel = frame.conditions.right_m if side > 0 else frame.conditions.left_m
    return float(np.pi * radius_m / max(np.abs(np.sum(wheel)), np.sum(np.abs(wheel)) * 0.1, 1e-6))


def _radii(frame: Frame, score: Floats, side: float) -> list[float]:
    """Radii of the strongest lines of a score over one wheel's distance."""
    wheel = frame.conditions.right_m if side > 0 else frame.conditions.left_m
    travelled = np.cumsum(wheel)
    middle = 0.5 * (travelled[frame.nodes.rows[1:]] + travelled[frame.nodes.rows[:-1]])
    weight = score * frame.nodes.between(travelled)
    step_m = 0.25 * 2.0 * np.pi * _RADII_M[0] / 2.0
    place = np.floor((middle - middle.min()) / step_m).astype(np.int64)
    even = np.bincount(place, weight)
    power = np.abs(np.fft.rfft(even, 4 * even.size)) ** 2
    per_m = np.fft.rfftfreq(4 * even.size, step_m)
    used = (per_m > 1 / (2 * np.pi * _RADII_M[1])) & (per_m < 1 / (2 * np.pi * _RADII_M[0]))
    # Against the neighbourhood: the noise of the score is not white over the frequencies.
    power = power / np.maximum(median_filter(power, 401, mode="nearest"), 1e-300)
    peak = used & (power >= np.roll(power, 1)) & (power >= np.roll(power, -1))
    order = np.argsort(np.where(peak, power, 0.0))[::-1][:_PEAKS]
    return [float(1 / (2 * np.pi * per_m[k])) for k in order if peak[k]]
