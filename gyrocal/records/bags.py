"""ROS 1 and ROS 2 bags (sqlite3 and MCAP) as drive logs, by the rosbags library (extra ``gyrocal[ros]``).

Gyro: ``sensor_msgs/Imu``, rate about z. Wheels: ``nav_msgs/Odometry`` (its pose steps, turned back into two sides
by the robot file's wheel separation) or ``sensor_msgs/JointState`` (angles of the joints whose names contain left
and right, times ``wheel_radius_m``). Temperature: ``sensor_msgs/Temperature``, where there is one. Truth, when a
topic is named: Odometry or ``geometry_msgs/PoseStamped``. Wheel distances are interpolated to the gyro's times.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal.errors import DataError, InputError, ProfileError
from gyrocal.records.csvio import Floats
from gyrocal.records.drive import DriveBlock
from gyrocal.records.files import reading
from gyrocal.units import RAD_TO_DEG

#: What a topic may be for, and the message types that can be it; `--topic NAME=TOPIC` chooses.
PURPOSES: Mapping[str, tuple[str, ...]] = {
    "imu": ("sensor_msgs/msg/Imu",),
    "wheels": ("nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState"),
    "temperature": ("sensor_msgs/msg/Temperature",),
    "truth": ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"),
}
_REQUIRED = ("imu", "wheels")
INSTALL = "install it with: pip install 'gyrocal[ros]'"


@dataclass(frozen=True)
class Wheels:
    """What turns a bag's wheel messages into metres: robot file's separation, and wheel radius for JointState."""

    separation_m: float
    radius_m: float | None = None


def is_bag(path: Path) -> bool:
    """Whether `path` is a ROS bag: a ``.bag``, ``.mcap`` or ``.db3`` file, or a directory with ``metadata.yaml``."""
    return path.suffix in (".bag", ".mcap", ".db3") or (path / "metadata.yaml").exists()


def read_bag(path: Path, wheels: Wheels, topics: Mapping[str, str] | None = None) -> DriveBlock:
    """A bag as a drive log, a row for each gyro message; it is held in memory whole.

    Raises
    ------
    InputError
        rosbags is not installed; not a bag, damaged, or without the topics; several candidates for a purpose.
    ProfileError
        JointState without ``wheel_radius_m`` in the robot file.
    DataError
        Gyro and wheels do not overlap in time.
    """
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError(f"{path}: reading ROS bags needs the rosbags library; {INSTALL}.") from error
    # A bag of ROS 2 is a directory; its one file alone is as good.
    whole = path.parent if path.suffix in (".mcap", ".db3") else path
    try:
        with (
            reading(path),
            AnyReader([whole], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader,
        ):
            chosen = _choose(path, {c.topic: c.msgtype for c in reader.connections}, topics or {})
            tables: dict[str, list[tuple[float, ...]]] = {purpose: [] for purpose in chosen}
            purposes = {topic: purpose for purpose, topic in chosen.items()}
            connections = [c for c in reader.connections if c.topic in purposes]
            for connection, stamp_ns, raw in reader.messages(connections=connections):
                message = reader.deserialize(raw, connection.msgtype)
                purpose = purposes[connection.topic]
                tables[purpose].append(_row(path, purpose, connection.msgtype, message, stamp_ns))
    except AnyReaderError as error:
        raise InputError(
            f"{path}: is not a readable ROS bag ({error}). Check that it was closed properly."
        ) from error
    arrays = {purpose: _in_order(path, purpose, rows) for purpose, rows in tables.items()}
    return _assemble(path, arrays, wheels)


def iterate_bag(
    path: Path, wheels: Wheels, topics: Mapping[str, str] | None = None, chunk_rows: int = 200_000
) -> Iterator[DriveBlock]:
    """`read_bag` in blocks, as `iterate_drive_log` gives them."""
    from gyrocal.records.drive import cut

    log = read_bag(path, wheels, topics)
    for start in range(0, len(log), chunk_rows):
        yield cut(log, slice(start, start + chunk_rows))


def _choose(path: Path, found: Mapping[str, str], asked: Mapping[str, str]) -> dict[str, str]:
    """Purpose -> topic: as asked, or the only one of its type."""
    chosen: dict[str, str] = {}
    for purpose, types in PURPOSES.items():
        candidates = sorted(topic for topic, msgtype in found.items() if msgtype in types)
        if purpose in asked:
            if asked[purpose] not in candidates:
                msg = f"{path}: topic {asked[purpose]!r} cannot be {purpose}; topics of type {' or '.join(types)}: {', '.join(candidates) or 'none'}."
                raise InputError(msg)
            chosen[purpose] = asked[purpose]
        elif purpose != "truth" and len(candidates) == 1:
            chosen[purpose] = candidates[0]
        elif purpose in _REQUIRED:
            listed = f"several ({', '.join(candidates)})" if candidates else "none"
            msg = f"{path}: {listed} of type {' or '.join(types)}; say which one is {purpose} with --topic {purpose}=TOPIC."
            raise InputError(msg)
    return chosen


def _row(path: Path, purpose: str, msgtype: str, message: Any, stamp_ns: int) -> tuple[float, ...]:
    stamp = message.header.stamp
    # A header that nobody filled in has the stamp 0: then the time of recording must do.
    t_s = stamp.sec + 1e-9 * stamp.nanosec if stamp.sec else 1e-9 * stamp_ns
    if purpose == "imu":
        return t_s, message.angular_velocity.z * RAD_TO_DEG
    if purpose == "temperature":
        return t_s, message.temperature
    if msgtype.endswith("JointState"):
        if len(message.position) != len(message.name):
            msg = f"{path}: a JointState has {len(message.name)} joints and {len(message.position)} positions; wheel angles are needed."
            raise InputError(msg)
        sides = [
            [p for name, p in zip(message.name, message.position, strict=True) if side in name.lower()]
            for side in ("left", "right")
        ]
        if not all(sides):
            msg = f"{path}: a JointState has joints {', '.join(message.name)[:120]}; names must contain left and right."
            raise InputError(msg)
        return t_s, float(np.mean(sides[0])), float(np.mean(sides[1]))
    pose = message.pose.pose if msgtype.endswith("Odometry") else message.pose
    q = pose.orientation
    heading = np.arctan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return t_s, pose.position.x, pose.position.y, float(heading)


def _in_order(path: Path, purpose: str, rows: list[tuple[float, ...]]) -> Floats:
    if not rows:
        raise InputError(f"{path}: the topic of {purpose} holds no message. Check what was recorded.")
    table = np.array(rows, dtype=np.float64)
    back = np.flatnonzero(np.diff(table[:, 0]) < 0)
    if back.size:
        msg = f"{path}: the time stamps of {purpose} go backwards at message {back[0] + 1}. Repair the bag."
        raise InputError(msg)
    return table


def _sides(path: Path, table: Floats, wheels: Wheels) -> tuple[Floats, Floats]:
    """Running totals of the left and right distance, m."""
    if table.shape[1] == 3:
        if wheels.radius_m is None:
            msg = f"{path}: has wheel angles (JointState), and the robot file has no wheel_radius_m; add it there."
            raise ProfileError(msg)
        return table[:, 1] * wheels.radius_m, table[:, 2] * wheels.radius_m
    heading = np.unwrap(table[:, 3])
    middle = heading[:-1] + 0.5 * np.diff(heading)
    along = np.cos(middle) * np.diff(table[:, 1]) + np.sin(middle) * np.diff(table[:, 2])
    travel = np.concatenate(([0.0], np.cumsum(along)))
    half = 0.5 * wheels.separation_m * (heading - heading[0])
    return travel - half, travel + half


def _assemble(path: Path, tables: Mapping[str, Floats], wheels: Wheels) -> DriveBlock:
    imu, wheel = tables["imu"], tables["wheels"]
    inside = (imu[:, 0] >= wheel[0, 0]) & (imu[:, 0] <= wheel[-1, 0])
    if np.count_nonzero(inside) < 2:
        msg = f"{path}: gyro and wheels do not overlap in time; they are not of one clock. Check the time stamps."
        raise DataError(msg)
    imu = imu[inside]
    t_s = imu[:, 0]
    left, right = (np.interp(t_s, wheel[:, 0], side) for side in _sides(path, wheel, wheels))
    nothing = np.full(t_s.size, np.nan)
    temp_c = nothing
    if "temperature" in tables:
        temp_c = np.interp(t_s, *tables["temperature"].T)
    truth = [nothing.copy() for _ in range(3)]
    if "truth" in tables:
        rows = np.searchsorted(t_s, tables["truth"][:, 0])
        here = rows < t_s.size
        for column, values in zip(truth, tables["truth"][here, 1:].T, strict=True):
            column[rows[here]] = values
        truth[2] = truth[2] * RAD_TO_DEG
    left, right = (np.diff(side, prepend=side[0]) for side in (left, right))
    return DriveBlock(1, t_s - t_s[0], left, right, imu[:, 1], temp_c, truth[0], truth[1], truth[2])
