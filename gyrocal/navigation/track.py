"""The paper's four conditions, and what is kept of a log that was navigated in one of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrocal.fusion import Counts, Navigator, RobotParameters, StaticBias, Trajectory
from gyrocal.navigation.align import Alignment, HeadingErrors, PositionErrors
from gyrocal.navigation.levels import Whiteness, as_taken, summed

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Rest:
    """The rest at the start: its bias, and the gyro's mean temperature in it, None where that is not known."""

    bias: StaticBias
    temp_c: float | None


@dataclass(frozen=True)
class Condition:
    """One of the paper's four ways to navigate."""

    id: str
    label: str
    calibrated: bool
    filtering: bool


CONDITIONS = (
    Condition("uncalibrated", "no calibration, no filter", False, False),
    Condition("uncalibrated_filter", "no calibration, filter", False, True),
    Condition("calibrated", "calibration, no filter", True, False),
    Condition("calibrated_filter", "calibration, filter", True, True),
)


class Leap(NamedTuple):
    """The row in which a rest takes a path that has no filter back, by the bias that the rest tells, and the pose before it."""

    t_s: float
    way_m: float
    turn_deg: float
    x_m: float
    y_m: float


@dataclass(frozen=True)
class Track:
    """A log navigated in one condition, at the kept rows.

    Attributes
    ----------
    x_m, y_m, heading_deg : ndarray, shape (k,)
        Start at the origin along +x (REP 103).
    states, std : ndarray, shape (k, 9)
        In the order of `gyrocal.fusion.STATES`; NaN without the filter.
    innovation_deg, innovation_sigma_deg : ndarray, shape (k,)
    covariance_before, covariance : ndarray, shape (9, 9)
        Of the state errors at the start and at the end.
    whiteness : Whiteness
        Of the innovations of all rows.
    nis_rows : int
        How many there were.
    drift_m : float
        Deviation of position that the model promises but for the scales' part, which is the same with the filter and
        without: root mean square over all rows; NaN for the paper's filter.
    robot : RobotParameters
        What the filter was told, noise estimated on this log included.
    leap : Leap, optional
        The largest; None with the filter, and without a rest that tells the bias.
    alignment, errors, heading_errors : None where there is no truth of positions, or of headings
    """

    condition: Condition
    x_m: Floats
    y_m: Floats
    heading_deg: Floats
    states: Floats
    std: Floats
    innovation_deg: Floats
    innovation_sigma_deg: Floats
    covariance_before: Floats
    covariance: Floats
    counts: Counts
    whiteness: Whiteness
    nis_rows: int
    drift_m: float
    bias: StaticBias | None
    robot: RobotParameters
    leap: Leap | None = None
    alignment: Alignment | None = None
    errors: PositionErrors | None = None
    heading_errors: HeadingErrors | None = None

    @property
    def pose(self) -> Floats:
        """Position and heading side by side, shape (k, 3)."""
        return np.stack([self.x_m, self.y_m, self.heading_deg], axis=1)


class Recorder:
    """Kept rows of one condition, and sums over all rows.

    Parameters
    ----------
    navigator : Navigator
        At the start of the log.
    """

    def __init__(self, navigator: Navigator) -> None:
        self._navigator, self._before = navigator, navigator.covariance
        self._parts: list[list[Floats]] = []
        self._nis_sum, self._nis_rows = 0.0, 0
        self._pair_sum, self._last = 0.0, 0.0
        self._drift_sum, self._rows = 0.0, 0
        self._slow_sum, self._sums, self._waiting = 0.0, 0, np.zeros(0)
        self._pose, self._leap = np.zeros(3), None if navigator.filtering else Leap(0.0, 0.0, 0.0, 0.0, 0.0)

    def add(self, t: Trajectory, keep: NDArray[np.bool_]) -> None:
        """Take the rows that are kept, and the innovations of all."""
        arrays = (
            t.x_m,
            t.y_m,
            t.heading_deg,
            t.states,
            t.std,
            t.innovation_deg,
            t.innovation_sigma_deg,
        )
        self._parts.append([a[keep] for a in arrays])
        if self._leap is not None and t.t_s.size:
            self._leap = self._larger(self._leap, t)
        self._drift_sum += float(t.drift_m @ t.drift_m)
        self._rows += t.drift_m.size
        normalised = t.innovation_deg / t.innovation_sigma_deg
        normalised = as_taken(normalised[np.isfinite(normalised)], self._navigator.robot.gate_sigma)
        if normalised.size:
            self._nis_sum += float(normalised @ normalised)
            self._nis_rows += normalised.size
            self._pair_sum += float(normalised[:-1] @ normalised[1:] + self._last * normalised[0])
            self._last = float(normalised[-1])
            sums, self._waiting = summed(np.concatenate([self._waiting, normalised]))
            self._slow_sum += float(sums @ sums)
            self._sums += sums.size

    def _larger(self, leap: Leap, t: Trajectory) -> Leap:
        """The larger one of a leap and those of the next rows: without the filter nothing but a rest is measured."""
        pose = np.vstack([self._pose, np.stack([t.x_m, t.y_m, t.heading_deg], axis=1)])
        self._pose = pose[-1]
        step = np.diff(pose, axis=0)
        way_m = np.where(np.isfinite(t.innovation_deg), np.hypot(step[:, 0], step[:, 1]), 0.0)
        k = int(np.argmax(way_m))
        if way_m[k] <= leap.way_m:
            return leap
        return Leap(*(float(v) for v in (t.t_s[k], way_m[k], step[k, 2], pose[k, 0], pose[k, 1])))

    def track(self, condition: Condition, rest: Rest | None) -> Track:
        """What was recorded."""
        navigator = self._navigator
        x, y, heading, states, std, z, sigma = (
            np.concatenate(parts) for parts in zip(*self._parts, strict=True)
        )
        seen = Whiteness(
            self._nis_sum / self._nis_rows if self._nis_rows else math.nan,
            self._pair_sum / self._nis_sum if self._nis_sum else math.nan,
            self._slow_sum / self._sums if self._sums else math.nan,
            self._sums,
        )
        return Track(
            condition,
            x,
            y,
            heading,
            states,
            std,
            z,
            sigma,
            self._before,
            navigator.covariance,
            navigator.counts,
            seen,
            self._nis_rows,
            math.sqrt(self._drift_sum / self._rows) if self._rows else math.nan,
            rest.bias if rest else None,
            navigator.robot,
            self._leap if self._leap is not None and self._leap.way_m > 0.0 else None,
        )
