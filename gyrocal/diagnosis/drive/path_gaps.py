"""A path that is laid on a truth begins anew after a gap in time: nobody knows how the robot went meanwhile.

A logger that lost rows has lost their way and turn, too; wheels that count on know how long the one was, and the other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.drive.reckoning import Complexes, Floats, Reckoned
from gyrocal.diagnosis.drive.yaw import YawNoise

Ints = NDArray[np.int64]


def unknown(path: Reckoned, noise: YawNoise) -> tuple[Floats, Floats]:
    """Standard deviations of the turn (rad) and of where the robot went (m) that each gap hides, shape (g,) each.

    As the robot goes elsewhere: by the rate of its mean radian and the speed of its mean metre, whatever it rests.
    """
    turned = np.abs(np.diff(path.heading_rad, prepend=path.heading_rad[0]))
    way = np.abs(path.way_m)
    seen = ~path.gap & (path.dt_s > 0)

    def usual(steps: Floats) -> Floats:
        rate = np.sum(steps[seen] ** 2 / path.dt_s[seen]) / max(np.sum(steps[seen]), 1e-9)
        return np.asarray(rate * path.dt_s[path.gap])

    turn_rad, way_m = usual(turned), usual(way)
    if not path.counts_on:
        return turn_rad, way_m
    # Of a way of known length it is unknown where in it the robot has turned.
    astray_m = way_m * np.minimum(turn_rad, 1.0)
    if path.track_m > 0.0:
        by_way = noise.slip_m_per_rt_m**2 * 2.0 * way[path.gap] + noise.tick_m**2
        by_turn = noise.turn**2 * turned[path.gap] + (noise.track_wander * turned[path.gap]) ** 2
        turn_rad = np.sqrt(by_turn + by_way / path.track_m**2)
    return turn_rad, astray_m


def after_gaps(path: Reckoned, rows: Ints, count: Floats) -> tuple[Floats, Complexes]:
    """Means over knots of what a turn and a way of one unit in each gap do to what follows it, shape (k, g) each.

    Parameters
    ----------
    rows, count : rows of the truth, and how many of them make each knot

    Returns
    -------
    share : of each knot that comes after each gap
    turned : what a turn of 1 rad moves it by, m
    """
    gaps = np.flatnonzero(path.gap)
    ends = np.cumsum(count.astype(np.int64))
    begins = np.maximum(np.concatenate([[0], ends[:-1]])[:, None], np.searchsorted(rows, gaps)[None, :])
    after = np.maximum(ends[:, None] - begins, 0)
    whole = np.concatenate([[0.0], np.cumsum(path.at_m[rows])])
    summed = np.where(after > 0, whole[ends][:, None] - whole[np.minimum(begins, ends[:, None])], 0.0)
    # The step of the gap itself turns by half.
    about = path.at_m[gaps] - 0.5 * path.steps_m[gaps]
    return after / count[:, None], 1j * (summed - after * about[None, :]) / count[:, None]


def first_turns(
    path: Reckoned,
    rows: Ints,
    count: Floats,
    apart: tuple[Complexes, Complexes],
    turn: float,
    white_m2: float,
    noise: YawNoise,
) -> Floats:
    """Turns in the gaps by which each part of a path lies best on the truth, rad, shape (g,), from the first part's on.

    Small errors about a part that lies askew would not tell by how much. What a part does not tell is as unlikely as large.

    Parameters
    ----------
    rows, count : as of `after_gaps`
    apart : means of the path and of the truth over each knot
    turn : of the first part
    white_m2, noise : variance of one row of the truth, and the noise of the wheels
    """
    share = after_gaps(path, rows, count)[0]
    part, in_one = np.sum(share, axis=1), np.all((share == 0.0) | (share == 1.0), axis=1)
    direction, found = np.exp(1j * turn), []
    for gap, std in enumerate(unknown(path, noise)[0], start=1):
        within = in_one & (part == gap)
        inner, total = 0.0j, float(np.sum(count[within]))
        if total > 0.0:
            path_m, truth_m = (x[within] - np.average(x[within], weights=count[within]) for x in apart)
            inner = complex(np.sum(count[within] * path_m.conj() * truth_m)) / white_m2
        best = std**2 * inner + direction
        best /= abs(best)
        found.append(float(np.angle(best / direction)))
        direction = best
    return np.array(found)
