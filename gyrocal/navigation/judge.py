"""Whether the filter describes a log, and whether it is worth more there than the gyro alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gyrocal.navigation.levels import describes
from gyrocal.navigation.track import Track

#: The filter must promise this share of the gyro's own deviation of position, or less: else it is all risk.
GAIN = 0.98


@dataclass(frozen=True)
class Judgement:
    """What the filter says of itself on a log, and what came of it.

    Attributes
    ----------
    nis, lag1 : float
        As in `Track`.
    consistent : bool
        Both lie where those of a filter do that describes the log.
    gain : float
        Deviation of position that the filter promises over that of the gyro alone, root mean square along the path;
        NaN where the filter says nothing of the gyro alone.
    left_to_gyro : bool
        The heading is left to the gyro, since the filter is not consistent or promises too little.
    """

    nis: float
    lag1: float
    consistent: bool
    gain: float
    left_to_gyro: bool


def judge(gyro: Track, filtered: Track) -> Judgement:
    """Judge a filter by its innovations and by what it promises; the truth has no part in it."""
    consistent = describes(filtered.nis, filtered.lag1)
    gain = _deviation(filtered) / _deviation(gyro)
    return Judgement(filtered.nis, filtered.lag1, consistent, gain, not consistent or gain > GAIN)


def left_to_gyro(gyro: Track, filtered: Track) -> Track:
    """The filter's track with the path of the gyro alone; its innovations stay, for they say why."""
    path = {
        name: getattr(gyro, name) for name in ("x_m", "y_m", "heading_deg", "states", "std", "covariance")
    }
    return replace(filtered, **path)


def _deviation(track: Track) -> float:
    """Deviation of position along the path but for the scales' part, which is the same with the filter and without."""
    at_m = track.x_m + 1j * track.y_m
    turned = np.radians(track.heading_deg - track.heading_deg[0])
    aside_m = np.cumsum(0.5 * (turned[1:] + turned[:-1]) * np.diff(at_m))
    scale_std = 0.0 if track.condition.calibrated else track.robot.gyro_scale_std
    common = scale_std**2 * np.abs(np.append(0.0, aside_m)) ** 2
    common += track.robot.way_std**2 * np.abs(at_m - at_m[0]) ** 2
    squares = track.std[:, 0] ** 2 + track.std[:, 1] ** 2
    # The steps between kept rows are straight: a little of the scales' part may be left, or taken too much.
    return float(np.sqrt(np.mean(np.maximum(squares - common, 0.0))))
