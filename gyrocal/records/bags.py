"""ROS 1 and ROS 2 bags (sqlite3 and MCAP) as drive logs, streamed by the rosbags library (extra ``gyrocal[ros]``).

Gyro: ``sensor_msgs/Imu``, the rate about one of its axes. Wheels: ``nav_msgs/Odometry`` (its pose steps, turned back
into two sides by the robot file's wheel separation), ``sensor_msgs/JointState`` (angles of the joints whose names
contain left and right, times ``wheel_radius_m``) or ``geometry_msgs/TwistStamped`` (one speed). Temperature:
``sensor_msgs/Temperature``, where there is one. Truth, when a topic is named: Odometry, ``geometry_msgs/PoseStamped``,
``sensor_msgs/NavSatFix`` (metres east and north of the first fix) or transforms (``/tf:PARENT:CHILD``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal.errors import GyrocalError, InputError, ProfileError
from gyrocal.records.bag_messages import Fixes, Message, axis_rates, pose_row, side_angles, transform_row
from gyrocal.records.csvio import Floats
from gyrocal.records.drive import DriveBlock
from gyrocal.records.files import reading
from gyrocal.records.streams import Merger
from gyrocal.records.timeline import Timeline, usual_step
from gyrocal.units import RAD_TO_DEG

_POSES = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped")
_TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
#: What a topic may be for, and the message types that can be it; `--topic NAME=TOPIC` chooses.
PURPOSES: Mapping[str, tuple[str, ...]] = {
    "imu": ("sensor_msgs/msg/Imu",),
    "wheels": ("nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState", "geometry_msgs/msg/TwistStamped"),
    "temperature": ("sensor_msgs/msg/Temperature",),
    "truth": (*_POSES, "sensor_msgs/msg/NavSatFix", *_TRANSFORMS),
}
_REQUIRED = ("imu", "wheels")
_FLUSH_MESSAGES = 20_000
#: Correlations with the turns of the wheels, second by second, of an axis that they are not on, and are on.
_OFF_AXIS, _ON_AXIS = 0.3, 0.7
_FEW_SECONDS = 10
INSTALL = "install it with: pip install 'gyrocal[ros]'"


@dataclass(frozen=True)
class Wheels:
    """What turns a bag's messages into a log: robot file's separation, wheel radius for JointState, axis of the IMU."""

    separation_m: float
    radius_m: float | None = None
    axis: str = "z"


def is_bag(path: Path) -> bool:
    """Whether `path` is a ROS bag: a ``.bag``, ``.mcap`` or ``.db3`` file, or a directory with ``metadata.yaml``."""
    return path.suffix in (".bag", ".mcap", ".db3") or (path / "metadata.yaml").exists()


def iterate_bag(path: Path, wheels: Wheels, topics: Mapping[str, str] | None = None) -> Iterator[DriveBlock]:
    """A bag as a drive log, a row for each gyro message, in blocks of bounded memory.

    Raises
    ------
    InputError
        rosbags is not installed; not a bag, damaged, or without the topics; several candidates for a purpose; the
        turns are on another axis of the IMU.
    ProfileError
        JointState without ``wheel_radius_m`` in the robot file.
    DataError
        Gyro and wheels do not overlap in time.
    """
    with _open(path) as reader:
        found = {connection.topic: connection.msgtype for connection in reader.connections}
    chosen = _choose(path, found, topics or {})
    gather = _Gather(path, chosen, wheels)
    for count, (purpose, message) in enumerate(_messages(path, chosen), start=1):
        gather.add(purpose, message)
        if count % _FLUSH_MESSAGES == 0:
            yield from gather.flush()
    yield from gather.flush(last=True)


def iterate_rates(path: Path, topic: str | None = None) -> Iterator[tuple[float, tuple[float, float, float]]]:
    """Time in s and rates about x, y and z in rad/s of the messages of a bag's IMU, as they were recorded.

    Raises
    ------
    InputError
        As `iterate_bag`; several IMUs and no `topic`.
    """
    with _open(path) as reader:
        found = {c.topic: c.msgtype for c in reader.connections if c.msgtype in PURPOSES["imu"]}
    chosen = _choose(path, found, {"imu": topic} if topic else {}, ("imu",))
    for _, message in _messages(path, chosen):
        yield message.t_s, axis_rates(message)


@contextmanager
def _open(path: Path) -> Iterator[Any]:
    """An open reader of rosbags; whatever it does at damaged bytes becomes a sentence."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError(f"{path}: reading ROS bags needs the rosbags library; {INSTALL}.") from error
    # A bag of ROS 2 is a directory; its one file alone is as good.
    whole = path.parent if path.suffix in (".mcap", ".db3") else path
    try:
        store = get_typestore(Stores.ROS2_HUMBLE)
        with reading(path), AnyReader([whole], default_typestore=store) as reader:
            yield reader
    except GyrocalError:
        raise
    except Exception as error:
        said = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise InputError(
            f"{path}: is not a readable ROS bag ({said}). Check that it was closed properly."
        ) from error


def _messages(path: Path, chosen: Mapping[str, tuple[str, str]]) -> Iterator[tuple[str, Message]]:
    """Purpose and message, in the order of recording."""
    purposes = {topic: purpose for purpose, (topic, _) in chosen.items()}
    with _open(path) as reader:
        connections = [c for c in reader.connections if c.topic in purposes]
        for connection, stamp_ns, raw in reader.messages(connections=connections):
            body = reader.deserialize(raw, connection.msgtype)
            yield purposes[connection.topic], Message(connection.msgtype, 1e-9 * stamp_ns, body)


def _choose(
    path: Path, found: Mapping[str, str], asked: Mapping[str, str], required: tuple[str, ...] = _REQUIRED
) -> dict[str, tuple[str, str]]:
    """Purpose -> topic and what was said behind it: as asked, or the only one of its type."""
    chosen: dict[str, tuple[str, str]] = {}
    for purpose, types in PURPOSES.items():
        candidates = sorted(topic for topic, msgtype in found.items() if msgtype in types)
        if purpose in asked:
            topic, _, frames = asked[purpose].partition(":")
            if topic not in candidates:
                msg = f"{path}: topic {topic!r:.80} cannot be {purpose}; topics of type {' or '.join(types)}: {', '.join(candidates) or 'none'}."
                raise InputError(msg)
            chosen[purpose] = (topic, frames)
        elif purpose != "truth" and len(candidates) == 1:
            chosen[purpose] = (candidates[0], "")
        elif purpose in required:
            listed = f"several ({', '.join(candidates)})" if candidates else "none"
            msg = f"{path}: {listed} of type {' or '.join(types)}; say which one is {purpose} with --topic {purpose}=TOPIC."
            raise InputError(msg)
    return chosen


class _Gather:
    """Messages, collected to tables and given to a merger; one clock for all of them."""

    def __init__(self, path: Path, chosen: Mapping[str, tuple[str, str]], wheels: Wheels) -> None:
        self._path = path
        self._wheels = wheels
        self._frames = chosen.get("truth", ("", ""))[1]
        self._rows: dict[str, list[tuple[float, ...]]] = {purpose: [] for purpose in chosen}
        self._heard: set[str] = set()
        self._merger: Merger | None = None
        self._clock: Timeline | None = None
        self._start_s = 0.0
        self._steps: list[tuple[float, float]] = []
        self._ways = _Ways(path, wheels)
        self._fixes = Fixes()
        self._turns = _Turns()

    def add(self, purpose: str, message: Message) -> None:
        """Take one message."""
        if purpose == "imu":
            row: tuple[float, ...] | None = (message.t_s, *axis_rates(message))
        elif purpose == "temperature":
            row = (message.t_s, float(message.body.temperature))
        elif purpose == "wheels":
            row = self._ways.row(message)
        elif message.msgtype.endswith("NavSatFix"):
            row = self._fixes.row(message)
        elif message.msgtype in _TRANSFORMS:
            row = transform_row(self._path, message, self._frames)
        else:
            row = pose_row(message)
        if row is not None:
            self._rows[purpose].append(row)

    def flush(self, *, last: bool = False) -> Iterator[DriveBlock]:
        """What is complete by now."""
        tables = {purpose: self._table(purpose) for purpose in self._rows}
        if last:
            for purpose in set(self._rows) - self._heard:
                msg = f"{self._path}: the topic of {purpose} holds no message. Check what was recorded."
                raise InputError(msg)
        if self._clock is None and len(tables["imu"]):
            self._start_s = float(tables["imu"][0, 0])
            usual_s = usual_step(self._path, tables["imu"][:1000, 0] - self._start_s)
            self._clock = Timeline(self._path, usual_s)
            names = {"gyro" if name == "imu" else name for name in self._rows}
            self._merger = Merger(self._path, names, speed_only=self._ways.speed_only)
        if self._clock is None or self._merger is None:
            for purpose, table in tables.items():
                self._rows[purpose] = [tuple(row) for row in table]
            return
        self._feed(self._clock, self._merger, tables)
        yield from self._merger.take(last=last)
        if last:
            self._turns.check(self._path, self._wheels.axis)

    def _table(self, purpose: str) -> Floats:
        rows, self._rows[purpose] = self._rows[purpose], []
        if not rows:
            return np.empty((0, 1))
        table = np.array(rows, dtype=np.float64)
        back = np.flatnonzero(np.diff(table[:, 0]) < 0)
        if back.size:
            msg = f"{self._path}: the time stamps of {purpose} go backwards at {table[back[0] + 1, 0]:.6f} s. Repair the bag."
            raise InputError(msg)
        if not np.isfinite(table).all() and purpose != "truth":
            raise InputError(f"{self._path}: a message of {purpose} holds no finite number. Repair the bag.")
        self._heard.add(purpose)
        return table

    def _feed(self, clock: Timeline, merger: Merger, tables: dict[str, Floats]) -> None:
        imu = tables.pop("imu")
        if len(imu):
            before_s = clock.last_s
            logged_s = imu[:, 0] - self._start_s
            t_s, segment, said = clock.take(1, logged_s)
            merger.say(said)
            for k in np.flatnonzero(np.diff(logged_s - t_s, prepend=logged_s[0] - t_s[0]) > 0):
                middle_s = 0.5 * (logged_s[k] + (logged_s[k - 1] if k else before_s))
                self._steps.append((float(middle_s), float(logged_s[k] - t_s[k])))
            sign = -1.0 if self._wheels.axis.startswith("-") else 1.0
            rates_dps = imu[:, 1:4] * RAD_TO_DEG
            self._turns.gyro(t_s, rates_dps)
            chosen = sign * rates_dps[:, "xyz".index(self._wheels.axis[-1])]
            merger.add("gyro", np.stack((t_s, chosen, segment.astype(np.float64)), axis=1))
        for name, table in tables.items():
            if len(table):
                closed = table.copy()
                closed[:, 0] = self._closed(table[:, 0] - self._start_s)
                if name == "wheels":
                    self._turns.wheels(closed)
                merger.add(name, closed)

    def _closed(self, t_s: Floats) -> Floats:
        """Times of another stream by the steps that the gyro's clock made."""
        shift_s = np.zeros(t_s.shape)
        for middle_s, total_s in self._steps:
            shift_s[t_s > middle_s] = total_s
        return t_s - shift_s


class _Ways:
    """Wheel messages as running totals of left and right, m."""

    def __init__(self, path: Path, wheels: Wheels) -> None:
        self._path = path
        self._wheels = wheels
        self.speed_only = False
        self._pose: tuple[float, float, float] | None = None
        self._told_s: float | None = None
        self._way_m = self._heading = 0.0

    def row(self, message: Message) -> tuple[float, ...]:
        """Time, left and right."""
        if message.msgtype.endswith("JointState"):
            if self._wheels.radius_m is None:
                msg = f"{self._path}: has wheel angles (JointState), and the robot file has no wheel_radius_m; add it there."
                raise ProfileError(msg)
            left, right = side_angles(self._path, message)
            return message.t_s, left * self._wheels.radius_m, right * self._wheels.radius_m
        if message.msgtype.endswith("TwistStamped"):
            self.speed_only = True
            since_s = 0.0 if self._told_s is None else message.t_s - self._told_s
            self._told_s = message.t_s
            self._way_m += message.body.twist.linear.x * since_s
            return message.t_s, self._way_m, self._way_m
        t_s, x, y, heading_deg = pose_row(message)
        heading = heading_deg / RAD_TO_DEG
        if self._pose is not None:
            turn = (heading - self._pose[2] + np.pi) % (2.0 * np.pi) - np.pi
            middle = self._pose[2] + 0.5 * turn
            self._way_m += np.cos(middle) * (x - self._pose[0]) + np.sin(middle) * (y - self._pose[1])
            self._heading += turn
        self._pose = (x, y, heading)
        half = 0.5 * self._wheels.separation_m * self._heading
        return t_s, self._way_m - half, self._way_m + half


class _Turns:
    """Turns second by second, of the wheels and about each axis of the IMU: are they on the axis that was said?"""

    def __init__(self) -> None:
        self._gyro: dict[int, Floats] = {}
        self._wheels: dict[int, float] = {}

    def gyro(self, t_s: Floats, rates_dps: Floats) -> None:
        """Mean rate of each axis in each second."""
        seconds = np.floor(t_s).astype(np.int64)
        starts = np.flatnonzero(np.diff(seconds, prepend=seconds[0] - 1))
        sums = np.add.reduceat(rates_dps, starts, axis=0)
        for second, total in zip(seconds[starts], sums, strict=True):
            self._gyro[int(second)] = self._gyro.get(int(second), np.zeros(3)) + total

    def wheels(self, table: Floats) -> None:
        """Difference of the sides at the end of each second."""
        for second, difference in zip(np.floor(table[:, 0]), table[:, 2] - table[:, 1], strict=True):
            self._wheels[int(second)] = float(difference)

    def check(self, path: Path, axis: str) -> None:
        """Refuse an axis that the turns are not on, where they are on another."""
        seconds = [s for s in self._gyro if s in self._wheels and s - 1 in self._wheels]
        turns = np.array([self._wheels[s] - self._wheels[s - 1] for s in seconds])
        rates = np.array([self._gyro[s] for s in seconds])
        if len(seconds) < _FEW_SECONDS or np.std(turns) == 0.0:
            return
        spread = np.std(rates, axis=0)
        matches = np.mean((rates - rates.mean(axis=0)) * (turns - turns.mean())[:, None], axis=0)
        matches = np.divide(matches, spread * np.std(turns), out=np.zeros(3), where=spread > 0)
        best = int(np.argmax(np.abs(matches)))
        if abs(matches["xyz".index(axis[-1])]) < _OFF_AXIS and abs(matches[best]) > _ON_AXIS:
            name = ("-" if matches[best] < 0 else "") + "xyz"[best]
            msg = f"{path}: the turns of the wheels are on the IMU's {'xyz'[best]} axis (correlation {matches[best]:.2f}), not on {axis}; say --axis {name}."
            raise InputError(msg)
