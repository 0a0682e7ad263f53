"""Whether the filter describes a log, and whether it is worth more there than the gyro alone."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal.navigation.levels import Whiteness
from gyrocal.navigation.track import Track

#: What the filter's deviation of position must be of the gyro's, or less, and by how many times it errs more than it promises: slip
#: that goes with the turns, a wheel that wears, the bumps of a path are white to its innovations. On 168 replays of second drives
#: of practice and one author (given and improved files) the geometric mean of the error against the gyro's was 0.742, 0.757 and
#: 0.760 with 1, 1.15 and 1.2 times, and the path more than a tenth worse on 6, 2 and 2; on 334 by three others, of 0.9 in place
#: of 0.95, it was 0.913 with 1, 0.897 to 0.899 from 1.15 to 1.35, and the path so much worse on 19 with 1 and on 8 with 1.2.
GAIN, ERRS = 0.95, 1.15
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
        Deviation of position to expect of the filter, by what it promises (`Track.drift_m`) and `ERRS`, over that of the gyro's
        path as this log shows it.
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

    A sound filter's error has nothing to do with what it took off the gyro's path: that path is off by the filter's deviation
    and by the way between the two, squared and added. But a share of that way is the filter's own, as it errs by `ERRS` times
    what it promises: the share of that variance beside what it says that it removed. By more than what the filter removed
    allows, no sound filter moves the path.
    """
    apart_m = math.sqrt(np.mean((filtered.x_m - gyro.x_m) ** 2 + (filtered.y_m - gyro.y_m) ** 2))
    # A filter's remaining error has nothing to do with what it removed: the variances add.
    removed_m = math.sqrt(max(gyro.drift_m**2 - filtered.drift_m**2, 0.0))
    apart = apart_m / removed_m if removed_m != 0.0 else math.inf
    promised = _gain(filtered.drift_m, removed_m, apart_m, 1.0)
    consistent = filtered.whiteness.describes and not (promised <= GAIN and apart > MOST_APART)
    gain = _gain(filtered.drift_m, removed_m, apart_m, ERRS)
    return Judgement(filtered.whiteness, apart, consistent, gain, not consistent or gain > GAIN)


def _gain(drift_m: float, removed_m: float, apart_m: float, errs: float) -> float:
    """Deviation of a filter that errs by `errs` times its promise over that of the gyro, given how far apart their paths are."""
    # Of a way that is the sum of two errors each has its share by variance, and both the same doubt of it.
    own, removed = (errs**2 - 1.0) * drift_m**2, removed_m**2
    share = own / (own + removed) if own + removed > 0.0 else 0.0
    either = drift_m**2 + share * removed
    off = either + ((1.0 - share) * apart_m) ** 2
    # A gyro that errs by nothing leaves nothing to gain.
    return math.sqrt((either + (share * apart_m) ** 2) / off) if off != 0.0 else math.inf


def left_to_gyro(gyro: Track, filtered: Track) -> Track:
    """The filter's track with the path of the gyro alone; its innovations stay, for they say why."""
    path = {
        name: getattr(gyro, name) for name in ("x_m", "y_m", "heading_deg", "states", "std", "covariance")
    }
    return replace(filtered, **path)
