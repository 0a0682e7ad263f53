"""The paper's test drive: a nearly square path of 210 m with two via points at each corner."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.inference.compiled import njit

Floats = NDArray[np.float64]

#: Integration steps of the true motion a sample of the log.
SUBSTEPS = 10


@dataclass(frozen=True)
class Motion:
    """How the robot drives; speeds and length are the paper's, the rest is usual for a Pioneer AT.

    Attributes
    ----------
    length_m, corner_m : float
        Length of the closed path, and how much of each side a corner's two via points cut off.
    speed_mps, slow_mps, slow_within_m : float
        Speed, and speed within that distance of a via point.
    acceleration_mps2, turn_dps, turn_acceleration_dps2 : float
        Limits of speed and of turn rate.
    steering_per_s : float
        Turn rate commanded for each deg of heading error to the next via point.
    reached_m : float
        Distance at which a via point counts as reached.
    """

    length_m: float = 210.0
    corner_m: float = 3.0
    speed_mps: float = 1.5
    slow_mps: float = 0.8
    slow_within_m: float = 4.0
    acceleration_mps2: float = 0.5
    turn_dps: float = 30.0
    turn_acceleration_dps2: float = 60.0
    steering_per_s: float = 1.5
    reached_m: float = 0.5


@dataclass(frozen=True)
class TruePath:
    """What the robot really does, sample by sample, shape (n,); the first sample is the start.

    ``distance_m`` and ``turn_deg`` are what the sample's interval brought; position and heading are at its end.
    """

    t_s: Floats
    distance_m: Floats
    turn_deg: Floats
    x_m: Floats
    y_m: Floats
    heading_deg: Floats


def square_via_points(motion: Motion, direction: int) -> Floats:
    """Eight via points of the nearly square path, shape (8, 2), m; the last one is the start.

    The robot starts at the origin along +x; `direction` +1 is counter-clockwise, -1 clockwise.
    """
    cut = motion.corner_m
    side = (motion.length_m - 4.0 * cut * math.sqrt(2.0)) / 4.0 + 2.0 * cut
    leg = side - 2.0 * cut
    corners = [
        (leg, 0.0),
        (leg + cut, cut),
        (leg + cut, cut + leg),
        (leg, 2.0 * cut + leg),
        (0.0, 2.0 * cut + leg),
        (-cut, cut + leg),
        (-cut, cut),
        (0.0, 0.0),
    ]
    return np.array([(x, direction * y) for x, y in corners])


def drive(via_m: Floats, motion: Motion, dt_s: float, static_s: float) -> TruePath:
    """Stand for `static_s`, then steer from via point to via point and stop at the last one.

    Parameters
    ----------
    via_m : ndarray, shape (k, 2), m
    dt_s : float
        Sample interval of the log; the motion itself is integrated in `SUBSTEPS` steps of it.
    """
    limits = np.array(
        [
            motion.speed_mps,
            motion.slow_mps,
            motion.slow_within_m,
            motion.acceleration_mps2,
            math.radians(motion.turn_dps),
            math.radians(motion.turn_acceleration_dps2),
            motion.steering_per_s,
            motion.reached_m,
        ]
    )
    standing = round(static_s / dt_s)
    legs = np.diff(via_m, axis=0, prepend=np.zeros((1, 2)))
    # Twice the time at the slow speed is more than any path that arrives at all can need.
    moving = int(2.0 * np.hypot(legs[:, 0], legs[:, 1]).sum() / (motion.slow_mps * dt_s))
    rows = _steer(via_m, limits, dt_s, moving)
    still = np.zeros((standing + 1, 5))
    distance, turn, x, y, heading = np.concatenate([still, rows]).T
    t_s = dt_s * np.arange(distance.size)
    return TruePath(t_s, distance, np.degrees(turn), x, y, np.degrees(heading))


@njit(cache=True)
def _steer(via_m: Floats, limits: Floats, dt_s: float, rows: int) -> Floats:  # pragma: no cover - compiled
    fast, slow, slow_within, acceleration, turn_max, turn_acceleration, gain, reached = limits
    h = dt_s / SUBSTEPS
    out = np.zeros((rows, 5))
    x = y = heading = speed = turn = 0.0
    target, from_x, from_y = 0, 0.0, 0.0
    last = via_m.shape[0] - 1
    for row in range(rows):
        distance = turned = 0.0
        for _ in range(SUBSTEPS):
            ahead = math.hypot(via_m[target, 0] - x, via_m[target, 1] - y)
            if ahead < reached and target < last:
                from_x, from_y = via_m[target]
                target += 1
                ahead = math.hypot(via_m[target, 0] - x, via_m[target, 1] - y)
            behind = math.hypot(from_x - x, from_y - y)
            near = min(ahead, behind if target > 0 else ahead) < slow_within
            wanted = slow if near else fast
            if target == last:
                wanted = min(wanted, math.sqrt(2.0 * acceleration * max(0.0, ahead - 0.02)))
            bearing = math.atan2(via_m[target, 1] - y, via_m[target, 0] - x)
            error = bearing - heading
            error -= 2.0 * math.pi * math.floor(error / (2.0 * math.pi) + 0.5)
            # At the very end the bearing means nothing any more: go straight.
            wanted_turn = min(max(gain * error, -turn_max), turn_max) if ahead > reached else 0.0
            speed += min(max(wanted - speed, -acceleration * h), acceleration * h)
            turn += min(max(wanted_turn - turn, -turn_acceleration * h), turn_acceleration * h)
            middle = heading + 0.5 * turn * h
            x += math.cos(middle) * speed * h
            y += math.sin(middle) * speed * h
            heading += turn * h
            distance += speed * h
            turned += turn * h
        out[row] = distance, turned, x, y, heading
        if target == last and speed < 1e-3:
            return out[: row + 1]
    return out
