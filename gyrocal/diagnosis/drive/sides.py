"""Turns to the left against those to the right: what differs between them is no scale, and turns to one side do not tell the two apart."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from gyrocal.diagnosis.drive.laws import strangers
from gyrocal.diagnosis.drive.levels import STRANGER_P
from gyrocal.diagnosis.drive.path_strangers import ONE_SIZE
from gyrocal.diagnosis.drive.search import YawAnswer
from gyrocal.diagnosis.drive.series import DriveSeries
from gyrocal.diagnosis.drive.truth import TruthAnswer
from gyrocal.diagnosis.drive.weighing import gram_of

#: Name of what a gyro's sides differ by: of figures and estimates, and below ``gyro`` in the robot file.
ASYMMETRY = "gyro_asymmetry"


@dataclass(frozen=True)
class Sides:
    """Turns of the encoders over those of the gyro, less one, to either side.

    Attributes
    ----------
    apart, apart_std : those to the left less those to the right
    even, even_std : the mean of both
    one_sided : how much more the turns that tell it go to the left than to the right, of all
    """

    apart: float
    apart_std: float
    even: float
    even_std: float
    one_sided: float

    @property
    def sure(self) -> float:
        """How far either is from their mean, where that is no chance: what noise allows besides would make a bias as uncertain."""
        if stats.norm.sf(abs(self.apart), scale=self.apart_std) > 0.5 * STRANGER_P:
            return 0.0
        return 0.5 * abs(self.apart)


def sides_of(yaw: YawAnswer) -> Sides:
    """Both sides by the encoders, whichever way this drive has turned more; nothing where the wheels have no track."""
    if "track" not in yaw.chosen:
        return Sides(0.0, 1.0, 0.0, 1.0, 0.0)
    # In an answer columns of no name are less what track and wheels could be of them.
    to_left = strangers(yaw.model.frame)["turn_rate"][:, 0]
    columns = {n: yaw.laws[n].column for n in yaw.chosen} | {"to_left": to_left}
    gram, track = gram_of(yaw.model, columns).knowing(yaw.known), yaw.chosen.index("track")
    values, covariance = gram.solve(list(columns))
    even = np.zeros(values.size)
    even[[track, -1]] = 1.0, 0.5
    apart_std, even_std = np.sqrt([covariance[-1, -1], even @ covariance @ even])
    share = gram.nearest("to_left", yaw.chosen)[track]
    return Sides(
        float(values[-1]), float(apart_std), float(even @ values), float(even_std), float(2.0 * share - 1.0)
    )


def uneven_gyro(truth: TruthAnswer | None) -> tuple[float, float] | None:
    """Scale of the gyro's turns to the left less that of those to the right, and its standard deviation.

    None where the truth is not sure of it, and where a bias in motion may have made it as well.
    """
    if truth is None or not truth.believed(ONE_SIZE) or truth.or_moving_dps is not None:
        return None
    # What a path lacks of every turn is read too little to the left and too much to the right.
    return -2.0 * truth.one_size, 2.0 * truth.stds[ONE_SIZE]


def evened(series: DriveSeries, yaw: YawAnswer, asymmetry: float) -> DriveSeries:
    """A log whose gyro has the same scale on both sides, for its wheels to be compared with.

    By smooth turns, for noise that is taken for turns would be a bias.
    """
    smooth_dps = yaw.model.frame.conditions.gyro_dps
    return replace(series, gyro_dps=series.gyro_dps - 0.5 * asymmetry * np.abs(smooth_dps))


def ratio_of_turns(yaw: YawAnswer, truth: TruthAnswer | None) -> tuple[float, float]:
    """Turns of the encoders over those of the gyro, less one, and its standard deviation; where its sides differ their mean."""
    if "turn_rate" in yaw.odd or (truth is not None and ONE_SIZE in truth.values):
        sides = sides_of(yaw)
        return sides.even, sides.even_std
    return yaw.estimate("track")
