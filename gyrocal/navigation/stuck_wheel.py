"""One wheel's counter that stands while the other wheel goes on, and the gyro does not turn as a robot about it would."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import DataError
from gyrocal.navigation.lost_ways import GAP_STEPS
from gyrocal.navigation.survey import MIN_TURN_DEG, WINDOW_S
from gyrocal.units import RAD_TO_DEG

Floats = NDArray[np.float64]

#: About a wheel that stands the gyro turns as the wheels do to within this factor, as wheels slip.
_WITHIN = 2.0
#: Above this share of a drive the log is refused, as for a gyro that is stuck.
_MOST = 0.25


class StuckWheel(NamedTuple):
    """From when to when a wheel's counter stood, and how far the other wheel went meanwhile."""

    side: str
    since_s: float
    until_s: float
    other_m: float


def stuck_wheels(
    t_s: Floats, left_m: Floats, right_m: Floats, gyro_deg: Floats, separation_m: float
) -> list[StuckWheel]:
    """Stretches in which one counter stood; shorter ones than `WINDOW_S` a late gyro hides.

    Parameters
    ----------
    t_s, left_m, right_m, gyro_deg : ndarray, shape (n,)
        Ends of rows or bins, and what wheels and gyro did in each; NaN where a wheel is not known.
    """
    steps_s = np.diff(t_s, prepend=t_s[0])
    usual_s = float(np.median(steps_s[1:])) if t_s.size > 1 else 0.0
    # Neither a bias (which the median has) nor a circle (which the median is) may look like a turn that lacks.
    median_dps = float(np.median(gyro_deg[1:] / np.maximum(steps_s[1:], 1e-9))) if t_s.size > 1 else 0.0
    found = []
    for side, own_m, other_m, sign in (("left", left_m, right_m, 1.0), ("right", right_m, left_m, -1.0)):
        still = (own_m == 0.0) & np.isfinite(other_m) & (steps_s <= GAP_STEPS * usual_s)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]])))
        for first, last in edges.reshape(-1, 2):
            going = first + np.flatnonzero(other_m[first:last])
            if not going.size or t_s[going[-1]] - t_s[going[0]] < WINDOW_S:
                continue
            rows = slice(going[0], going[-1] + 1)
            since_s, until_s = float(t_s[rows][0] - steps_s[rows][0]), float(t_s[rows][-1])
            wheels_deg = sign * RAD_TO_DEG * float(np.sum(other_m[rows])) / separation_m
            gyro = float(np.sum(gyro_deg[rows]))
            off_deg = min(
                abs(wheels_deg - turned) for turned in (gyro, gyro - median_dps * (until_s - since_s))
            )
            if off_deg > max(MIN_TURN_DEG, (1.0 - 1.0 / _WITHIN) * abs(wheels_deg)):
                found.append(StuckWheel(side, since_s, until_s, float(np.sum(np.abs(other_m[rows])))))
    return found


def refuse_stuck(name: str, stuck: Sequence[StuckWheel], duration_s: float) -> None:
    """Refuse a log in which a counter stood for long.

    Raises
    ------
    DataError
    """
    for wheel in stuck:
        if wheel.until_s - wheel.since_s > _MOST * duration_s:
            msg = f"{name}: {_said(wheel)}; that is more than a quarter of the drive. Check its cable, or cut the log there."
            raise DataError(msg)


def stuck_said(stuck: Sequence[StuckWheel], *, bridged: bool) -> tuple[str, ...]:
    """What is said of each stretch; `bridged`: whether the speeds beside it stand in its place."""
    then = (
        "its way there is taken from the speeds before and after"
        if bridged
        else "from there on the path lacks half of that way"
    )
    return tuple(f"{_said(wheel)}; {then}" for wheel in stuck)


def _said(wheel: StuckWheel) -> str:
    return (
        f"the {wheel.side} encoder stands from t_s = {wheel.since_s:.0f} to {wheel.until_s:.0f} while the other wheel goes {wheel.other_m:.3g} m, "
        "and the gyro does not turn as a robot about a standing wheel does: it was stuck"
    )
