"""Whether the filter describes a log, and whether it is worth more there than the gyro alone."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal.navigation.levels import Whiteness
from gyrocal.navigation.track import Track

#: The filter must promise this share of the gyro's deviation of position, or less. On 167 second drives 0.95 left the path
#: more than a tenth worse on 10 %, 0.9 on 5 %, 0.8 on 3 %, and the geometric mean was least at 0.9 (README, "The filter").
GAIN = 0.9
#: Beyond so many times what it should be, once in 100 where both deviations hold and all of it is along one direction, and more
#: seldom along several, the way between filter and gyro says that one of them does not. On 187 second drives on which the
#: innovations were as they should be it was 0.78 (rms) and at most 2.0, but for 2.9 on a slope, with 29 times the error.
MOST_APART = 2.58


@dataclass(frozen=True)
class Judgement:
    """What the filter says of itself on a log, and what came of it.

    Attributes
    ----------
    whiteness : Whiteness
        As in `Track`.
    apart : float
        Way between filter and gyro over what their deviations make of it; NaN for the paper's filter, which promises nothing.
    consistent : bool
        Innovations are those of a filter that describes the log, and it moves the gyro's path by no more than it says.
    gain : float
        Deviation of position that the filter promises (`Track.drift_m`) over that of the gyro's path as this log shows it.
    left_to_gyro : bool
        The heading is left to the gyro, since the filter is not consistent or promises too little.
    """

    whiteness: Whiteness
    apart: float
    consistent: bool
    gain: float
    left_to_gyro: bool


def judge(gyro: Track, filtered: Track) -> Judgement:
    """Judge a filter by its innovations and by what it promises; the truth has no part in it.

    A filter's error has nothing to do with what it took off the gyro's path: that path is off by the filter's deviation and
    by the way between the two, squared and added. What the gyro may err by beforehand counts for nothing, since a
    gyro that is better than it says, or in luck, would be given up for it. But by more than that and what the filter has left
    of it allow, no sound filter moves the path.
    """
    apart_m = math.sqrt(np.mean((filtered.x_m - gyro.x_m) ** 2 + (filtered.y_m - gyro.y_m) ** 2))
    off_m = math.hypot(filtered.drift_m, apart_m)
    # A gyro that errs by nothing leaves nothing to gain.
    gain = filtered.drift_m / off_m if off_m != 0.0 else math.inf
    # A filter's remaining error has nothing to do with what it removed: the variances add.
    removed_m = math.sqrt(max(gyro.drift_m**2 - filtered.drift_m**2, 0.0))
    apart = apart_m / removed_m if removed_m != 0.0 else math.inf
    consistent = filtered.whiteness.describes and not (gain <= GAIN and apart > MOST_APART)
    return Judgement(filtered.whiteness, apart, consistent, gain, not consistent or gain > GAIN)


def left_to_gyro(gyro: Track, filtered: Track) -> Track:
    """The filter's track with the path of the gyro alone; its innovations stay, for they say why."""
    path = {
        name: getattr(gyro, name) for name in ("x_m", "y_m", "heading_deg", "states", "std", "covariance")
    }
    return replace(filtered, **path)
