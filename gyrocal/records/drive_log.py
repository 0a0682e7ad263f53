"""The reader of drive logs: our CSV or a foreign one by its mapping, of one file or several, in bounded memory."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError, ProfileError
from gyrocal.records.columns import MAP_THEM, UNITS, ColumnMap, ColumnRule, mapped_header, scaled
from gyrocal.records.csvio import Floats, iterate_columns, read_header, require_columns
from gyrocal.records.drive import DriveBlock
from gyrocal.records.leaps import FASTEST_ROBOT_MPS, Leaps
from gyrocal.records.streams import Merger
from gyrocal.records.timeline import Timeline, usual_step

_QUATERNION = ("truth_qx", "truth_qy", "truth_qz", "truth_qw")
#: How the way may be told in our own logs: columns -> names of the rules, and their unit.
_WAYS: tuple[tuple[tuple[str, ...], tuple[str, ...], str], ...] = (
    (("left_ticks", "right_ticks"), ("left_m", "right_m"), "ticks_total"),
    (("speed_mps",), ("speed_m",), "m/s"),
    (("speed_m",), ("speed_m",), "m"),
    (("left_m", "right_m"), ("left_m", "right_m"), "m"),
)
COLUMNS = (
    "t_s",
    *dict.fromkeys(name for names, _, _ in _WAYS for name in names),
    "steering_deg",
    "gyro_dps",
    "gyro_temp_c",
    "truth_x_m",
    "truth_y_m",
    "truth_heading_deg",
    *_QUATERNION,
)
_CHUNK_ROWS = 200_000
#: Of a log with positions as angles, which bags hold (NavSatFix) and are projected there.
_PROJECT = " Latitude and longitude are not read from CSV: project them to metres, east as truth_x_m, north as truth_y_m."
#: Rows that tell the usual time step and whether columns are streams of different rates.
_HEAD_ROWS = 1000
#: Streams are of different rates when more than this share of one's rows has nothing of the other.
_SPARSE_SHARE = 0.5
_TRUTH = ("truth_x_m", "truth_y_m", "truth_heading_deg")

Rules = Mapping[str, ColumnRule]


@dataclass(frozen=True)
class _Read:
    """Rows as one file has them, and in which of them the way is told, shape (n,)."""

    block: DriveBlock
    way_known: NDArray[np.bool_]


def iterate_drive_log(
    path: Path,
    metres_per_tick: tuple[float, float] | None = None,
    columns: ColumnMap | None = None,
    chunk_rows: int = _CHUNK_ROWS,
) -> Iterator[DriveBlock]:
    """Yield the drive log `path` in blocks of at most `chunk_rows` rows.

    Where the columns are streams of different rates, the log has a row for each gyro sample (see `Merger`).

    Parameters
    ----------
    metres_per_tick : (left, right), m
        From the robot file; needed when the log is in ticks.
    columns : ColumnMap, optional
        Mapping of a foreign log; None reads the columns of formats.md.

    Raises
    ------
    InputError
        A missing or unknown column, a cell that is text or infinite, time that is empty, going backwards or not in
        seconds, no rows.
    ProfileError
        The log is in ticks and the robot file has no ``metres_per_tick``.
    DataError
        Streams that do not overlap in time.
    """
    header = read_header(path)
    rules = _native_rules(path, header) if columns is None else dict(columns)
    files = _by_file(path, rules)
    scales = _tick_scales(path, rules, metres_per_tick)
    if len(files) > 1:
        yield from _merge_files(path, files, scales, chunk_rows)
        return
    reads = _read_file(path, header, rules, scales, chunk_rows)
    head: list[_Read] = []
    while sum(len(read.block) for read in head) < _HEAD_ROWS and (more := next(reads, None)):
        head.append(more)
    if not head:
        raise InputError(f"{path}: has a header and no rows. Check that it was written to its end.")
    if _is_sparse(head):
        yield from _merge_columns(path, rules, itertools.chain(head, reads))
        return
    if any(rules[name].unit.speed for name in scales):
        # Of single rows without a speed the navigator holds the last one: the next must not tell their way again.
        head, reads = [], _read_file(path, header, rules, scales, chunk_rows, by_row=True)
    yield from (read.block for read in itertools.chain(head, reads))


def _read_file(
    path: Path,
    header: list[str],
    rules: Rules,
    scales: Mapping[str, float],
    chunk_rows: int,
    *,
    by_row: bool = False,
) -> Iterator[_Read]:
    """Rows of one file, as they stand there; the clock's steps closed.

    Parameters
    ----------
    by_row : whether a speed holds since the row before, not since the speed before
    """
    only = list(dict.fromkeys(name for rule in rules.values() for name in rule.sources))
    blocks = (item for item in iterate_columns(path, header, chunk_rows, only) if item[1][only[0]].size)
    head: list[tuple[int, dict[str, Floats]]] = []
    while sum(raw[only[0]].size for _, raw in head) < _HEAD_ROWS and (more := next(blocks, None)):
        head.append(more)
    if not head:
        return
    first_s = np.concatenate([scaled(path, line, rules["t_s"], raw) for line, raw in head])
    timeline = Timeline(path, usual_step(path, first_s))
    ways = {name: _Way(rules[name], scales[name], by_row) for name in scales}
    leaps = {name: Leaps(path, rules[name], scales[name], timeline.usual_dt_s) for name in scales}
    for first_line, raw in itertools.chain(head, blocks):
        values = {name: scaled(path, first_line, rule, raw) for name, rule in rules.items()}
        logged_s = values["t_s"]
        steps = {name: way.steps(values[name], logged_s) for name, way in ways.items() if way.counts}
        went_on = np.zeros(logged_s.size, dtype=np.bool_)
        for counted_m, _ in steps.values():
            went_on |= np.abs(counted_m) > FASTEST_ROBOT_MPS * timeline.usual_dt_s
        t_s, segment, said = timeline.take(first_line, logged_s, went_on)
        steps |= {name: way.steps(values[name], t_s) for name, way in ways.items() if not way.counts}
        for name, (steps_m, _) in steps.items():
            leaps[name].refuse(first_line, raw, steps_m, t_s)
        yield _assemble(first_line, t_s, values, steps, segment, said)


def _assemble(
    first_line: int,
    t_s: Floats,
    values: Mapping[str, Floats],
    steps: Mapping[str, tuple[Floats, NDArray[np.bool_]]],
    segment: NDArray[np.int64],
    said: tuple[str, ...],
) -> _Read:
    nothing = (np.full(t_s.shape, np.nan), np.zeros(t_s.shape, dtype=np.bool_))
    (left, left_known), (right, right_known) = (
        steps.get("speed_m", steps.get(name, nothing)) for name in ("left_m", "right_m")
    )
    others = {name: values[name] for name in ("gyro_temp_c", *_TRUTH, "steering_deg") if name in values}
    empty = dict.fromkeys(("gyro_temp_c", *_TRUTH), nothing[0])
    known = left_known & right_known
    block = DriveBlock(
        first_line,
        t_s,
        left,
        right,
        values.get("gyro_dps", nothing[0]),
        **(empty | others),
        segment=segment,
        speed_only="speed_m" in steps,
        late_counts=int(np.count_nonzero(~known & np.isfinite(left + right))),
        notes=said,
    )
    return _Read(block, known)


def _is_sparse(head: Iterable[_Read]) -> bool:
    """Whether gyro and way are streams of different rates that share the rows of one file."""
    reads = list(head)
    gyro = np.concatenate([np.isfinite(read.block.gyro_dps) for read in reads])
    way = np.concatenate([read.way_known for read in reads])
    if not (gyro.any() and way.any()):
        return False
    return bool(np.mean(~way[gyro]) > _SPARSE_SHARE or np.mean(~gyro[way]) > _SPARSE_SHARE)


def _streams(rules: Rules) -> tuple[str, ...]:
    """Names of the streams that the columns of a file make up."""
    makes = {
        "gyro": ("gyro_dps",),
        "wheels": ("left_m", "right_m", "speed_m"),
        "temperature": ("gyro_temp_c",),
        "steering": ("steering_deg",),
        "truth": _TRUTH,
    }
    return tuple(name for name, columns in makes.items() if not rules.keys().isdisjoint(columns))


class _Feed:
    """Rows of one file, given to a merger as the streams that they hold."""

    def __init__(self, merger: Merger, rules: Rules) -> None:
        self._merger = merger
        self.streams = _streams(rules)
        self._total_m = np.zeros((2, 1))

    def give(self, read: _Read) -> None:
        block = read.block
        tables: dict[str, tuple[Floats, ...]] = {
            "gyro": (block.gyro_dps, block.segment.astype(np.float64)),
            "wheels": self._totals(read),
            "temperature": (block.gyro_temp_c,),
            "steering": (block.steering_deg,),
            "truth": (block.truth_x_m, block.truth_y_m, block.truth_heading_deg),
        }
        for name in self.streams:
            table = np.stack((block.t_s, *tables[name]), axis=1)
            told = read.way_known if name == "wheels" else np.isfinite(table[:, 1:]).any(axis=1)
            if name == "gyro":
                told = np.isfinite(block.gyro_dps)
            # Between its rows a stream is interpolated: only of truth is it known that none was missed.
            until_s = float(block.t_s[-1]) if name == "truth" else None
            self._merger.add(name, table[told], until_s)

    def _totals(self, read: _Read) -> tuple[Floats, Floats]:
        steps_m = np.stack((read.block.left_m, read.block.right_m))
        left, right = self._total_m + np.cumsum(np.where(np.isfinite(steps_m), steps_m, 0.0), axis=1)
        self._total_m = np.array([[left[-1]], [right[-1]]])
        return left, right


def _merge_columns(path: Path, rules: Rules, reads: Iterable[_Read]) -> Iterator[DriveBlock]:
    """Streams of one file, in which each row holds what came at its time."""
    merger = Merger(path, _streams(rules), speed_only="speed_m" in rules)
    feed = _Feed(merger, rules)
    for read in reads:
        feed.give(read)
        merger.say(read.block.notes)
        yield from merger.take()
    yield from merger.take(last=True)


def _merge_files(
    path: Path, files: Mapping[Path, Rules], scales: Mapping[str, float], chunk_rows: int
) -> Iterator[DriveBlock]:
    """Streams of several files of one clock; the one that lags behind is read next."""
    every = {name for rules in files.values() for name in _streams(rules)}
    merger = Merger(path, every, speed_only=any("speed_m" in rules for rules in files.values()))
    open_files: dict[str, tuple[Path, _Feed, Iterator[_Read]]] = {}
    for file, rules in files.items():
        feed = _Feed(merger, rules)
        own = {name: scales[name] for name in scales if name in rules}
        reads = _read_file(file, mapped_header(file, rules), rules, own, chunk_rows)
        open_files |= dict.fromkeys(feed.streams, (file, feed, reads))
    while True:
        file, feed, reads = open_files[merger.behind()]
        read = next(reads, None)
        if read is None:
            for name in feed.streams:
                merger.add(name, np.empty((0, 0)), np.inf)
            if merger.behind() in feed.streams:
                break
            continue
        if read.block.notes:
            msg = f"{file}: {read.block.notes[0].split(';')[0]}. Streams of several files need one clock: cut them there."
            raise InputError(msg)
        feed.give(read)
        yield from merger.take()
    yield from merger.take(last=True)


def _native_rules(path: Path, header: list[str]) -> dict[str, ColumnRule]:
    found = [way for way in _WAYS if not set(way[0]).isdisjoint(header)]
    names, rule_names, unit = found[0] if found else _WAYS[-1]
    angles = any(
        name.lower().split("_")[0] in ("lat", "latitude", "lon", "lng", "longitude") for name in header
    )
    require_columns(
        path, header, ("t_s", *names, "gyro_dps"), COLUMNS, MAP_THEM + (_PROJECT if angles else "")
    )
    if len(found) > 1:
        what = {"left_ticks": "ticks", "left_m": "metres"}
        both = " and ".join(what.get(way[0][0], way[0][0]) for way in found[:2])
        raise InputError(f"{path}, line 1: has both {both}. Remove one of them; the way is told once.")
    rules = {rule: ColumnRule(name, UNITS[rule][unit]) for name, rule in zip(names, rule_names, strict=True)}
    plain = {name: next(iter(units.values())) for name, units in UNITS.items()}
    way = {name for _, rule_names, _ in _WAYS for name in rule_names}
    rules |= {
        name: ColumnRule(name, unit) for name, unit in plain.items() if name in header and name not in way
    }
    if not set(_QUATERNION).isdisjoint(header):
        require_columns(path, header, (*_QUATERNION, *names, "gyro_dps"), COLUMNS)
        if "truth_heading_deg" in header:
            raise InputError(
                f"{path}, line 1: has both truth_heading_deg and a quaternion. Remove one of them."
            )
        unit_of = UNITS["truth_heading_deg"]["quaternion"]
        rules["truth_heading_deg"] = ColumnRule(_QUATERNION[0], unit_of, quaternion=_QUATERNION)
    return {name: rules[name] for name in UNITS if name in rules}


def _by_file(path: Path, rules: Rules) -> dict[Path, dict[str, ColumnRule]]:
    """The rules of each file, with the time of each; the log itself first."""
    files: dict[Path, dict[str, ColumnRule]] = {path: {}}
    for name, rule in rules.items():
        files.setdefault(path if rule.file is None else path.parent / rule.file, {})[name] = rule
    for file, own in files.items():
        times = {rule.time or rules["t_s"].source for rule in own.values() if rule.file is not None}
        if len(times) > 1:
            raise InputError(
                f"{file}: is mapped with two columns of time ({', '.join(sorted(times))}). Say one."
            )
        if file != path:
            own["t_s"] = replace(rules["t_s"], source=times.pop())
        if len({"left_m", "right_m"} & own.keys()) == 1:
            raise InputError(f"{path}: left_m and right_m are mapped to two files. Both have to be in one.")
    for file, own in files.items():
        mapped_header(file, own)
    return files


def _tick_scales(path: Path, rules: Rules, metres_per_tick: tuple[float, float] | None) -> dict[str, float]:
    """Factor to metres of each column that tells the way."""
    told = [name for name in ("left_m", "right_m", "speed_m") if name in rules]
    if metres_per_tick is None and any(rules[name].unit.ticks for name in told):
        msg = f"{path}: is in ticks, and the robot file has no metres_per_tick; add metres_per_tick = [LEFT, RIGHT] there."
        raise ProfileError(msg)
    left, right = metres_per_tick or (1.0, 1.0)
    scale = {"left_m": left, "right_m": right, "speed_m": 0.5 * (left + right)}
    return {name: scale[name] if rules[name].unit.ticks else 1.0 for name in told}


class _Way:
    """A column that tells distance, speed or a count, as distances since the row before; blocks follow each other."""

    def __init__(self, rule: ColumnRule, scale: float, by_row: bool) -> None:
        self._rule = rule
        self._scale = scale
        self._by_row = by_row
        self._counter = np.nan
        self._told_s: float | None = None
        self.counts = rule.unit.total

    def steps(self, values: Floats, t_s: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Distances in m, and which rows tell one, shape (n,)."""
        told = np.isfinite(values)
        known = np.flatnonzero(told)
        if self._told_s is None:
            self._told_s = float(t_s[0])
        if self._rule.unit.speed and self._by_row:
            steps = values * np.diff(t_s, prepend=self._told_s)
            self._told_s = float(t_s[-1])
            return steps * self._scale, told
        if not known.size:
            standing = 0.0 if self._rule.unit.total and np.isfinite(self._counter) else np.nan
            return np.full(values.shape, standing), told
        if self._rule.unit.speed:
            # A speed holds since the one before it, however many rows lie between.
            steps = np.full(values.shape, np.nan)
            steps[known] = values[known] * np.diff(t_s[known], prepend=self._told_s)
            self._told_s = float(t_s[known[-1]])
            return steps * self._scale, told
        if self._rule.unit.total:
            return self._scale * self._counted(values, known), told
        return self._scale * values, told

    def _counted(self, values: Floats, known: NDArray[np.intp]) -> Floats:
        steps = np.zeros(values.shape)
        if np.isnan(self._counter):  # never told: missing, not standing
            steps[: known[0]] = np.nan
        first = values[known[0]] if np.isnan(self._counter) else self._counter
        # A counter that misses a row tells the whole distance at the next one: nothing is lost.
        steps[known] = np.diff(values[known], prepend=first)
        self._counter = float(values[known[-1]])
        if self._rule.wrap is not None:
            half = 0.5 * self._rule.wrap * self._rule.unit.factor
            steps = (steps + half) % (2.0 * half) - half
        return steps
