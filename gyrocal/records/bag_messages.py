"""What single ROS messages say, as rows of numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gyrocal.errors import InputError
from gyrocal.units import RAD_TO_DEG

#: WGS 84: semi-major axis, m, and first eccentricity squared.
_WGS84_A_M, _WGS84_E2 = 6378137.0, 6.69437999014e-3
#: NavSatStatus: no fix.
_NO_FIX = -1


@dataclass(frozen=True)
class Message:
    """A message, its type, and when it was recorded, s."""

    msgtype: str
    recorded_s: float
    body: Any

    @property
    def t_s(self) -> float:
        """Time of its header; one that nobody filled in has the stamp 0: then the time of recording must do."""
        return _stamp_s(self.body.header, self.recorded_s)


def _stamp_s(header: Any, recorded_s: float) -> float:
    stamp = header.stamp
    return float(stamp.sec + 1e-9 * stamp.nanosec) if stamp.sec else recorded_s


def axis_rates(message: Message) -> tuple[float, float, float]:
    """Rates about x, y and z of an Imu, rad/s."""
    rate = message.body.angular_velocity
    return float(rate.x), float(rate.y), float(rate.z)


def heading_deg(q: Any) -> float:
    """Heading of a quaternion, deg, counter-clockwise."""
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z)) * RAD_TO_DEG


def pose_row(message: Message) -> tuple[float, float, float, float]:
    """Time, x, y (m) and heading (deg) of an Odometry or PoseStamped."""
    pose = message.body.pose.pose if message.msgtype.endswith("Odometry") else message.body.pose
    return message.t_s, float(pose.position.x), float(pose.position.y), heading_deg(pose.orientation)


def transform_row(path: Path, message: Message, frames: str) -> tuple[float, float, float, float] | None:
    """Time, x, y, heading of the transform PARENT:CHILD in a TFMessage; None where this one does not hold it.

    Raises
    ------
    InputError
        Several transforms, and nobody said which.
    """
    parent, _, child = frames.partition(":")
    found = [
        t
        for t in message.body.transforms
        if not frames or (t.header.frame_id.lstrip("/"), t.child_frame_id.lstrip("/")) == (parent, child)
    ]
    if len(found) > 1 or (found and not frames):
        pairs = ", ".join(f"{t.header.frame_id}:{t.child_frame_id}" for t in found[:5])
        raise InputError(
            f"{path}: say which transform is the truth, with --topic truth=TOPIC:PARENT:CHILD (found: {pairs})."
        )
    if not found:
        return None
    move = found[0].transform
    t_s = _stamp_s(found[0].header, message.recorded_s)
    return t_s, float(move.translation.x), float(move.translation.y), heading_deg(move.rotation)


def side_angles(path: Path, message: Message) -> tuple[float, float]:
    """Mean angle of the left and of the right joints of a JointState, rad."""
    names, positions = message.body.name, message.body.position
    if len(positions) != len(names):
        msg = f"{path}: a JointState has {len(names)} joints and {len(positions)} positions; wheel angles are needed."
        raise InputError(msg)
    sides = [
        [float(p) for name, p in zip(names, positions, strict=True) if side in name.lower()]
        for side in ("left", "right")
    ]
    if not all(sides):
        msg = f"{path}: a JointState has joints {', '.join(names)[:120]}; names must contain left and right."
        raise InputError(msg)
    return sum(sides[0]) / len(sides[0]), sum(sides[1]) / len(sides[1])


class Fixes:
    """Fixes of a satellite receiver as metres east (x) and north (y) of the first, on the ellipsoid there."""

    def __init__(self) -> None:
        self._origin: tuple[float, float] | None = None

    def row(self, message: Message) -> tuple[float, float, float, float] | None:
        """Time, x, y and no heading; None where there is no fix."""
        fix = message.body
        sound = math.isfinite(fix.latitude) and math.isfinite(fix.longitude) and abs(fix.latitude) <= 90.0
        if fix.status.status == _NO_FIX or not sound:
            return None
        if self._origin is None:
            self._origin = (fix.latitude, fix.longitude)
        latitude, longitude = self._origin
        across = (fix.longitude - longitude + 180.0) % 360.0 - 180.0
        sine = math.sin(latitude / RAD_TO_DEG)
        curve = 1.0 - _WGS84_E2 * sine * sine
        north_m = _WGS84_A_M * (1.0 - _WGS84_E2) / curve**1.5 * (fix.latitude - latitude) / RAD_TO_DEG
        east_m = _WGS84_A_M / curve**0.5 * math.cos(latitude / RAD_TO_DEG) * across / RAD_TO_DEG
        return message.t_s, east_m, north_m, math.nan
