"""Columns of no name of a path that is laid on a truth: what no figure of a robot file does to it."""

from __future__ import annotations

import numpy as np

from gyrocal.diagnosis.drive.laws import SPEED_SMOOTH_S, by_place
from gyrocal.diagnosis.drive.path_noise import Knots, stacked
from gyrocal.diagnosis.drive.reckoning import Floats, Reckoned
from gyrocal.diagnosis.drive.series import usual_step_s

#: Parts of a drive in which the gyro may be late, or have a bias of its own.
_PARTS = 8
#: Columns of the bias of single parts among those without a name, less that of the last: their mean is zero.
BIAS_PARTS = tuple(f"time:{k}" for k in range(_PARTS - 1))
#: The column of wheels that go further while the speed grows, s^2/m: a name has it in the catalogue.
SPINNING = "acceleration:0"
#: The column of turns that have one sign whichever way they go.
ONE_SIZE = "turn_rate:0"


def path_strangers(knots: Knots, path: Reckoned) -> dict[str, dict[str, Floats]]:
    """Columns of no name, and `SPINNING`, by coordinate; each of shape (rows,)."""
    turned = np.diff(path.heading_rad, prepend=path.heading_rad[0])
    share = (path.t_s - path.t_s[0]) / float(np.ptp(path.t_s)) - 0.5
    speed = np.divide(np.abs(path.way_m), path.dt_s, out=np.zeros_like(share), where=path.dt_s > 0)
    turning = np.divide(turned, path.dt_s, out=np.zeros_like(share), where=path.dt_s > 0)
    rate, nothing = np.abs(turning), np.zeros(share.size)
    whole, span_s = np.cumsum(path.way_m), max(SPEED_SMOOTH_S, usual_step_s(path.t_s))
    ahead, behind = (np.interp(path.t_s + s, path.t_s, whole) for s in (span_s, -span_s))
    # From row to row whole ticks come and go, and what rises of that alone would grow with the way.
    growth = (np.abs(ahead - whole) - np.abs(whole - behind)) / span_s**2
    # Wheels that stand for the gyro have no bias.
    seen_s = np.where(path.gap, 0.0, path.dt_s) if path.track_m > 0.0 else path.dt_s
    part = np.minimum(np.floor(_PARTS * (share + 0.5)), _PARTS - 1)
    within = (part == np.arange(_PARTS)[:, None]).astype(np.float64)
    errors = {
        "turn_rate": [(np.abs(turned), nothing), (turned * rate, nothing), (nothing, path.way_m * rate)],
        "speed": [(nothing, path.way_m * speed), (path.way_m, nothing)],
        # Wheels that spin or slide: where the speed grows, and where it falls.
        "acceleration": [
            (nothing, sign * path.way_m * np.maximum(-sign * growth, 0.0)) for sign in (-1.0, 1.0)
        ],
        # First a bias that is another one from some time on, or for a while.
        "time": [(seen_s * (within[k] - within[-1]), nothing) for k in range(_PARTS - 1)]
        + [(turned * share, nothing), (nothing, path.way_m * share)],
        # A gyro that is late in one part of the drive and not in others.
        "delay": [(np.diff(turning * inside, prepend=0.0), nothing) for inside in within],
        "heading": [(turned * f(2 * path.heading_rad), nothing) for f in (np.cos, np.sin)]
        + [(seen_s * f(path.heading_rad), nothing) for f in (np.cos, np.sin)],
        # A slope lies where it lies.
        "place": [(turns, nothing) for turns in by_place(path.t_s, path.heading_rad, path.way_m, turned)],
    }
    found = {
        name: np.stack(
            [
                stacked(knots, knots.mean(path.moved_by(np.cumsum(turn), way)), knots.mean(np.cumsum(turn)))
                for turn, way in parts
            ],
            axis=1,
        )
        for name, parts in errors.items()
        if parts
    }
    # What moves positions alone is not seen in headings alone.
    seen = {
        name: {f"{name}:{k}": column for k, column in enumerate(block.T) if np.any(column != 0.0)}
        for name, block in found.items()
    }
    return {name: block for name, block in seen.items() if block}
