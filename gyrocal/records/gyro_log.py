"""Plain logs of a gyro from whoever wrote them: our CSV, PX4 (ULog, extra ``px4``), ArduPilot (extra ``ardupilot``), ROS bags (extra ``ros``)."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from io import StringIO
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal.errors import GyrocalError, InputError
from gyrocal.records.bags import is_bag, iterate_rates
from gyrocal.records.columns import read_column_map
from gyrocal.records.csvio import Floats
from gyrocal.records.files import reading
from gyrocal.records.static_log import StaticBlock, cut_at_steps, iterate_static_log
from gyrocal.records.timeline import Timeline, usual_step
from gyrocal.units import RAD_TO_DEG

#: PX4: topics that hold rates in rad/s, the one nearest to the sensor first, and their fields.
_PX4 = (
    ("sensor_gyro", {"x": "x", "y": "y", "z": "z"}),
    ("sensor_combined", {"x": "gyro_rad[0]", "y": "gyro_rad[1]", "z": "gyro_rad[2]"}),
)
_ARDUPILOT = {"x": "GyrX", "y": "GyrY", "z": "GyrZ"}
_CHUNK_ROWS = 500_000
_US_PER_S = 1e6
#: No gyro of a vehicle turns so fast.
_LARGEST_RPS = 1e6
_DAMAGED = ("parts of the file are damaged and left out",)
#: Telemetry is a few messages a second, filtered and without clocks of its own.
_TELEMETRY = ".tlog"

#: Of a log whose gyro says nothing.
ALL_EMPTY = "fewer than two samples of the gyro are there that are neither empty nor infinite. Check its column, and log again."


@dataclass(frozen=True)
class GyroChoice:
    """Which gyro of a log is meant.

    Attributes
    ----------
    axis : str
        Of a log with three axes: x, y or z; a minus before it turns the sign.
    instance : int
        Of an autopilot's log: which of its gyros, from 0.
    topic : str, optional
        Of a bag with several IMUs.
    columns : Path, optional
        Mapping of a foreign CSV (`records.columns`).
    """

    axis: str = "z"
    instance: int = 0
    topic: str | None = None
    columns: Path | None = None


def iterate_gyro_log(path: Path, choice: GyroChoice | None = None) -> Iterator[StaticBlock]:
    """Yield the log `path` in blocks: ``.ulg`` of PX4, ``.bin`` of ArduPilot, a ROS bag, else a CSV (see `iterate_static_log`).

    Raises
    ------
    InputError
        The extra is not installed; a damaged file; no such gyro in it; something asked that the log does not have.
    """
    choice = choice or GyroChoice()
    axis, instance, topic = choice.axis, choice.instance, choice.topic
    autopilot = path.suffix.lower() in (".ulg", ".bin")
    if choice.columns is not None and (autopilot or is_bag(path)):
        raise InputError(f"{path}: is no CSV, and columns are mapped of one. Leave --columns out.")
    if path.suffix.lower() == _TELEMETRY:
        raise InputError(
            f"{path}: is telemetry of a ground station, a few filtered samples a second. Take the autopilot's own log: .bin of ArduPilot, .ulg of PX4."
        )
    if topic is not None and not is_bag(path):
        raise InputError(f"{path}: is no ROS bag, and a topic is of one. Leave it out.")
    if is_bag(path):
        if instance:
            raise InputError(f"{path}: is a ROS bag, and an instance is of an autopilot's log. Give a topic.")
        return _iterate_bag(path, axis, topic)
    if path.suffix.lower() == ".ulg":
        return _iterate_ulog(path, axis, instance)
    if path.suffix.lower() == ".bin":
        return _iterate_dataflash(path, axis, instance)
    if axis != "z" or instance:
        raise InputError(
            f"{path}: is a CSV, and axis and instance are of an autopilot's log. Leave them out."
        )
    return iterate_static_log(
        path, mapping=None if choice.columns is None else read_column_map(choice.columns, way=False)
    )


def _iterate_ulog(path: Path, axis: str, instance: int) -> Iterator[StaticBlock]:
    """PX4; pyulog holds the one topic in memory, 40 bytes a sample."""
    with _parsing(path, "pyulog", "px4"):
        from pyulog import ULog

        with path.open("rb") as file:
            log = ULog(file, [name for name, _ in _PX4])
        found = {(data.name, data.multi_id): data.data for data in log.data_list}
        notes = _DAMAGED if log.file_corruption else ()
    for topic, fields in _PX4:
        data = found.get((topic, instance))
        if data is None:
            continue
        stamp = data["timestamp_sample"] if "timestamp_sample" in data else data["timestamp"]
        nothing = np.full(stamp.shape, np.nan)
        blocks = _blocks(
            path,
            _numbers(stamp) / _US_PER_S,
            _numbers(data[fields[axis[-1]]]),
            _numbers(data.get("temperature", nothing)),
            axis,
        )
        yield from _noted(blocks, (f"read: {topic} {instance}, axis {axis}", *notes))
        return
    known = ", ".join(f"{name} {number}" for name, number in sorted(found)) or "none"
    raise InputError(f"{path}: holds no gyro {instance} (found: {known}). Choose another instance.")


def _iterate_bag(path: Path, axis: str, topic: str | None) -> Iterator[StaticBlock]:
    """ROS 1 and 2, streamed; the temperature has no clock of its own there and is left out."""
    clock: list[Timeline] = []
    notes: tuple[str, ...] = (f"read: {topic or 'the only IMU of the bag'}, axis {axis}",)
    messages = iterate_rates(path, topic)
    while rows := list(islice(messages, _CHUNK_ROWS)):
        t_s, rate_rps = (np.array(column, dtype=np.float64) for column in zip(*rows, strict=True))
        nothing = np.full(t_s.shape, np.nan)
        blocks = _blocks(path, t_s, rate_rps[:, "xyz".index(axis[-1])], nothing, axis, clock)
        yield from _noted(blocks, notes)
        notes = ()


def _iterate_dataflash(path: Path, axis: str, instance: int) -> Iterator[StaticBlock]:
    """ArduPilot, streamed: each sample of the sensor (``GYR``) where the log has them, else what filters left (``IMU``)."""
    with _parsing(path, "pymavlink", "ardupilot"):
        raw = any(int(m.I) == instance for m in _dataflash_messages(path, {"GYR"}))
    kind, stamp = ("GYR", "SampleUS") if raw else ("IMU", "TimeUS")
    rows: list[tuple[float, float, float]] = []
    seen: set[int] = set()
    clock: list[Timeline] = []
    notes: tuple[str, ...] = (f"read: {kind} messages of gyro {instance}, axis {axis}",)
    temp_c = np.nan
    messages = _dataflash_messages(path, {kind, "IMU"})
    while True:
        with _parsing(path, "pymavlink", "ardupilot") as said:
            message = next(messages, None)
            if message is not None:
                number = int(getattr(message, "I", 0))
                seen.add(number)
                if number == instance:
                    temp_c = float(getattr(message, "T", temp_c))
                    if message.get_type() == kind:
                        rate = float(getattr(message, _ARDUPILOT[axis[-1]]))
                        rows.append((getattr(message, stamp) / _US_PER_S, rate, temp_c))
        notes = (*notes, *_DAMAGED) if said.getvalue() and not set(_DAMAGED) <= set(notes) else notes
        if rows and (message is None or len(rows) == _CHUNK_ROWS):
            t_s, rate_rps, temps_c = np.array(rows, dtype=np.float64).T
            yield from _noted(_blocks(path, t_s, rate_rps, temps_c, axis, clock), notes)
            rows, notes = [], ()
        if message is None:
            break
    if instance not in seen:
        known = ", ".join(map(str, sorted(seen))) or "none"
        raise InputError(f"{path}: holds no gyro {instance} (found: {known}). Choose another instance.")


def _dataflash_messages(path: Path, kinds: set[str]) -> Iterator[Any]:
    from pymavlink.DFReader import DFReader_binary

    with _compiled_code_silenced():
        log = DFReader_binary(str(path))
    try:
        # A kind that the log does not declare is looked for message by message, to its end.
        while not kinds.isdisjoint(log.name_to_id) and (message := log.recv_match(type=kinds)) is not None:
            yield message
    finally:
        log.close()


@contextmanager
def _compiled_code_silenced() -> Iterator[None]:
    """pymavlink's compiled indexer writes a line for each bad byte past Python, straight to the standard error."""
    try:
        kept = os.dup(2)
    except OSError:  # nobody listens there
        yield
        return
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _noted(blocks: Iterator[StaticBlock], notes: tuple[str, ...]) -> Iterator[StaticBlock]:
    """Blocks, the first with notes on the whole."""
    for k, block in enumerate(blocks):
        yield replace(block, notes=(*notes, *block.notes)) if k == 0 else block


def _numbers(column: Any) -> Floats:
    with np.errstate(invalid="ignore"):  # what damage made of a number may be any kind of NaN
        return np.asarray(column, dtype=np.float64)


def _blocks(
    path: Path,
    t_s: Floats,
    rate_rps: Floats,
    temp_c: Floats,
    axis: str,
    clock: list[Timeline] | None = None,
) -> Iterator[StaticBlock]:
    """Rows as blocks; `clock` keeps the timeline of a log that comes in several pieces."""
    timelines = [] if clock is None else clock
    if not timelines:
        timelines.append(Timeline(path, usual_step(path, t_s[:1000]), closes=False))
    huge = np.flatnonzero(np.abs(rate_rps) > _LARGEST_RPS)
    if huge.size:
        msg = f"{path}, sample {huge[0] + 1}: the rate is {rate_rps[huge[0]]:.3g} rad/s, which no gyro measures. The file is damaged."
        raise InputError(msg)
    sign = -1.0 if axis.startswith("-") else 1.0
    columns = {"t_s": t_s, "gyro_dps": sign * RAD_TO_DEG * rate_rps, "temp_c": temp_c}
    for start in range(0, t_s.size, _CHUNK_ROWS):
        piece = {name: values[start : start + _CHUNK_ROWS] for name, values in columns.items()}
        yield from cut_at_steps(timelines[0], 1 + start, piece)


@contextmanager
def _parsing(path: Path, library: str, extra: str) -> Iterator[StringIO]:
    """What a parser by other hands does at damaged bytes becomes a sentence; what it prints, line by line, is kept back."""
    said = StringIO()
    try:
        with reading(path), redirect_stdout(said), redirect_stderr(said):
            yield said
    except ImportError as error:
        msg = f"{path}: reading it needs the {library} library; install it with: pip install 'gyrocal[{extra}]'."
        raise InputError(msg) from error
    except GyrocalError:
        raise
    except Exception as error:
        why = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise InputError(
            f"{path}: cannot be read as a log of an autopilot ({why}). Check that it was closed properly."
        ) from error
