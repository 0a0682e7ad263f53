"""The run directory, ``gyrocal-run/1``: what `acquire` writes and `fit`, `report`, `diagnose` read."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.records.csvio import Floats, iterate_columns, read_header, require_columns
from gyrocal.records.files import parse_json, read_text, reading, sha256_of_file
from gyrocal.records.recognise import not_a_run

SCHEMA = "gyrocal-run/1"
COLUMNS = (
    "t_s",
    "gyro_dps",
    "gyro_temp_c",
    "status",
    "table_rate_dps",
    "table_angle_deg",
    "chamber_temp_c",
    "supply_v",
)
KINDS = ("rate", "static", "ramp", "soak")
OUTCOMES = ("ok", "unsettled", "failed")

_CHUNK_ROWS = 500_000
_RESTORE = "The journal is append-only: restore it."

#: Averages that are longer than this times the spacing of their rows would share samples, and their 1/f noise would
#: not have a covariance; a jitter of the clock is less.
_OVERLAPPING = 1.3
#: No number of a run is larger; it also keeps infinity and integers that no float holds out.
_LARGEST = 1e15


@dataclass(frozen=True)
class Sensor:
    """Who the gyro is; None where the logger did not say."""

    model: str
    serial: str | None = None
    rate_range_dps: tuple[float, float] | None = None
    temp_range_c: tuple[float, float] | None = None
    sample_rate_hz: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain data for ``run.json`` and the coefficient file; unknown entries are left out."""
        entries: dict[str, Any] = {
            "model": self.model,
            "serial": self.serial,
            "rate_range_dps": list(self.rate_range_dps) if self.rate_range_dps else None,
            "temp_range_c": list(self.temp_range_c) if self.temp_range_c else None,
            "sample_rate_hz": self.sample_rate_hz,
        }
        return {key: value for key, value in entries.items() if value is not None}


@dataclass(frozen=True)
class SegmentRecord:
    """A segment's line in the journal."""

    id: int
    kind: str
    rate_dps: float
    chamber_c: float
    t_start_s: float
    t_end_s: float
    n: int
    averaging_s: float | None
    outcome: str
    file: str
    sha256: str


@dataclass(frozen=True)
class Segment:
    """A segment's samples. Gyro rows and bench rows keep their own times; NaN is an empty cell.

    Attributes
    ----------
    t_s, gyro_dps, gyro_temp_c, status : ndarray, shape (n,)
        Gyro samples, s, deg/s, deg C; status 0 is good.
    bench_t_s, table_rate_dps, table_angle_deg, chamber_temp_c, supply_v : ndarray, shape (m,)
        Bench readings, s, deg/s, deg (unwrapped), deg C, V.
    """

    record: SegmentRecord
    t_s: Floats
    gyro_dps: Floats
    gyro_temp_c: Floats
    status: Floats
    bench_t_s: Floats
    table_rate_dps: Floats
    table_angle_deg: Floats
    chamber_temp_c: Floats
    supply_v: Floats

    @property
    def good(self) -> NDArray[np.bool_]:
        """Mask, shape (n,): finite rate and status 0. The rest is counted by whoever uses the segment."""
        return np.asarray(np.isfinite(self.gyro_dps) & (self.status == 0))

    def supply_held(self, last_v: float) -> tuple[Floats, float]:
        """Supply at each gyro sample: its last reading, `last_v` before the first; and the last of all."""
        read = np.isfinite(self.supply_v)
        values = np.concatenate([[last_v], self.supply_v[read]])
        return values[np.searchsorted(self.bench_t_s[read], self.t_s, side="right")], float(values[-1])


@dataclass(frozen=True)
class Run:
    """A run directory, opened: identity and journal in memory, samples read a segment at a time.

    Attributes
    ----------
    compensated : Any
        What ``run.json`` says under ``compensated`` (there, or in ``sensor`` or ``software``): true, or the name
        or sha256 of the coefficients that the logged rates went through already. None: nothing said.
    """

    path: Path
    sensor: Sensor
    bench: Mapping[str, Any]
    power_on_t_s: float | None
    profile: Mapping[str, Any] | None
    profile_sha256: str | None
    created_utc: str | None
    software: Any
    segments: tuple[SegmentRecord, ...]
    events: tuple[Mapping[str, Any], ...]
    notes: tuple[str, ...]
    compensated: Any = None

    def segment(self, record: SegmentRecord) -> Segment:
        """Read one segment whole, once its sha256 is that of the journal.

        Raises
        ------
        InputError
            Missing, edited, truncated, or malformed segment file, or time going backwards in it.
        """
        self.verify(record)
        parts = list(self.iterate_segment(record))
        if len(parts) == 1:
            return parts[0]
        names = [name for name in Segment.__dataclass_fields__ if name != "record"]
        joined = {name: np.concatenate([getattr(p, name) for p in parts]) for name in names}
        return Segment(record=record, **joined)

    def verify(self, record: SegmentRecord) -> None:
        """Compare a segment file's sha256 with its journal line."""
        path = self.path / record.file
        with reading(path):
            digest = sha256_of_file(path)
        if digest != record.sha256:
            msg = (
                f"{path}: differs from what the journal sealed (sha256). It was edited, truncated or damaged: "
                "restore it, or remove its line and acquire the segment again with --resume."
            )
            raise InputError(msg)

    def iterate_segment(self, record: SegmentRecord, chunk_rows: int = _CHUNK_ROWS) -> Iterator[Segment]:
        """Yield a segment in blocks of at most `chunk_rows` rows, in bounded memory."""
        path = self.path / record.file
        header = read_header(path)
        require_columns(path, header, ("t_s", "gyro_dps"), COLUMNS)
        last_t_s = -np.inf
        for first_line, columns in iterate_columns(path, header, chunk_rows):
            t_s = columns["t_s"]
            _check_time(path, first_line, t_s, last_t_s)
            last_t_s = t_s[-1] if t_s.size else last_t_s
            yield _split_rows(record, columns)

    def __iter__(self) -> Iterator[Segment]:
        return (self.segment(record) for record in self.segments)


def _check_time(path: Path, first_line: int, t_s: Floats, before_s: float) -> None:
    bad = np.flatnonzero(~np.isfinite(t_s))
    if bad.size:
        raise InputError(f"{path}, line {first_line + bad[0]}: t_s is empty or not finite. Repair the line.")
    steps = np.diff(t_s, prepend=before_s)
    back = np.flatnonzero(steps < 0)
    if back.size:
        line = first_line + int(back[0])
        msg = f"{path}, line {line}: time goes backwards by {-steps[back[0]]:.6g} s. Rows must be in time order; repair the log."
        raise InputError(msg)


def _split_rows(record: SegmentRecord, columns: dict[str, Floats]) -> Segment:
    empty = np.full(columns["t_s"].shape, np.nan)
    c = {name: columns.get(name, empty) for name in COLUMNS}
    bench = (
        np.isfinite(c["table_rate_dps"])
        | np.isfinite(c["table_angle_deg"])
        | np.isfinite(c["chamber_temp_c"])
        | np.isfinite(c["supply_v"])
    )
    gyro = np.isfinite(c["gyro_dps"]) | np.isfinite(c["status"]) | ~bench
    status = c["status"][gyro] if "status" in columns else np.zeros(int(gyro.sum()))
    return Segment(
        record,
        c["t_s"][gyro],
        c["gyro_dps"][gyro],
        c["gyro_temp_c"][gyro],
        status,
        c["t_s"][bench],
        c["table_rate_dps"][bench],
        c["table_angle_deg"][bench],
        c["chamber_temp_c"][bench],
        c["supply_v"][bench],
    )


def is_run_directory(path: Path) -> bool:
    """Whether `path` looks like a run directory."""
    return path.is_dir() and (path / "run.json").exists()


def runs_in(path: Path) -> list[Path]:
    """The runs in a directory of runs, in the order in which they were made; what is none stays as it is."""
    if (path / "run.json").exists() or not path.is_dir():
        return [path]
    inside = sorted(entry for entry in path.iterdir() if (entry / "run.json").exists())
    return sorted(inside, key=lambda run: read_run(run).created_utc or "") or [path]


def read_run(path: Path) -> Run:
    """Open the run directory `path`.

    Raises
    ------
    InputError
        No ``run.json``, another schema, no sensor, or a damaged journal.
    """
    source = path / "run.json"
    if path.exists() and not source.exists():
        with reading(path):
            raise InputError(f"{path}: {not_a_run(path)}")
    head = parse_json(read_text(source), str(source), "The file may be truncated.")
    found = head.get("schema") if isinstance(head, dict) else None
    if found != SCHEMA:
        raise InputError(
            f"{source}: schema is {found!r:.80}, and this program reads {SCHEMA!r:.80}. Check the path or update gyrocal."
        )
    _check_head(source, head)
    notes = [
        f"run.json does not say {key}"
        for key in ("created_utc", "power_on_t_s", "profile")
        if key not in head
    ]
    segments, events = _read_journal(path, notes)
    return Run(
        path=path,
        sensor=_read_sensor(source, head),
        bench=head.get("bench") or {},
        power_on_t_s=head.get("power_on_t_s"),
        profile=head.get("profile"),
        profile_sha256=head.get("profile_sha256"),
        created_utc=head.get("created_utc"),
        software=head.get("software"),
        segments=segments,
        events=events,
        notes=tuple(notes),
        compensated=_compensated(head),
    )


def _leaves(file: str) -> bool:
    """Whether a path leads out of the run directory."""
    parts = PurePosixPath(file).parts
    return not parts or ".." in parts or file.startswith("/")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _LARGEST


def _check_head(source: Path, head: Mapping[str, Any]) -> None:
    """Refuse optional entries of the wrong kind; what is missing is only unknown."""
    for key in ("bench", "profile"):
        if not isinstance(head.get(key) or {}, dict):
            raise InputError(
                f"{source}: {key} is {head[key]!r:.80}, and an object is wanted. Leave it out or repair it."
            )
    power_on_t_s = head.get("power_on_t_s")
    if not (power_on_t_s is None or _is_number(power_on_t_s)):
        raise InputError(
            f"{source}: power_on_t_s is {power_on_t_s!r:.80}, and a number of seconds is wanted. Leave it out or repair it."
        )


def _compensated(head: Mapping[str, Any]) -> Any:
    for place in (head, head.get("sensor"), head.get("software")):
        if isinstance(place, Mapping) and place.get("compensated"):
            return place["compensated"]
    return None


def _read_sensor(source: Path, head: dict[str, Any]) -> Sensor:
    raw = head.get("sensor")
    if not isinstance(raw, dict) or not raw.get("model"):
        raise InputError(f"{source}: sensor.model is missing. Write at least the model of the gyro there.")

    def pair(key: str) -> tuple[float, float] | None:
        value = raw.get(key)
        if value is None:
            return None
        if not (
            isinstance(value, list)
            and len(value) == 2
            and all(map(_is_number, value))
            and value[0] < value[1]
        ):
            raise InputError(
                f"{source}: sensor.{key} is {value!r:.80}, and a list of two numbers, the smaller first, is wanted."
            )
        return float(value[0]), float(value[1])

    serial, rate_hz = raw.get("serial"), raw.get("sample_rate_hz")
    if not (rate_hz is None or (_is_number(rate_hz) and rate_hz > 0)):
        raise InputError(
            f"{source}: sensor.sample_rate_hz is {rate_hz!r:.80}, and a positive number is wanted."
        )
    return Sensor(
        str(raw["model"]),
        None if serial is None else str(serial),
        pair("rate_range_dps"),
        pair("temp_range_c"),
        rate_hz,
    )


def _read_journal(
    path: Path, notes: list[str]
) -> tuple[tuple[SegmentRecord, ...], tuple[Mapping[str, Any], ...]]:
    source = path / "journal.jsonl"
    lines = read_text(source).splitlines()
    events: list[Mapping[str, Any]] = []
    sealed: dict[int, SegmentRecord] = {}
    named: dict[str, int] = {}
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            event = parse_json(line, f"{source}, line {number}", _RESTORE)
        except InputError:
            if number < len(lines):
                raise
            # A crash can tear the line that was being written; the segment it spoke of is redone by --resume.
            notes.append(f"journal.jsonl, line {number} was cut off by a crash and is ignored")
            break
        _check_event(source, number, event)
        events.append(event)
        if event.get("event") == "segment":
            record = _segment_record(source, number, event)
            if record.file in named:
                msg = f"{source}, line {number}: names {record.file}, as line {named[record.file]} does. {_RESTORE}"
                raise InputError(msg)
            named[record.file] = number
            sealed[record.id] = record
    notes += _incomplete(path, events, sealed.values())
    records = [_own_averaging(record) for record in sealed.values()]
    if changed := sum(a is not b for a, b in zip(sealed.values(), records, strict=True)):
        notes.append(
            f"journal.jsonl says of {changed} of {len(records)} segments an averaging_s that is none, or longer than rows lie "
            "apart; their spacing is taken instead"
        )
    return tuple(sorted(records, key=lambda r: (r.t_start_s, r.id))), tuple(events)


def _own_averaging(record: SegmentRecord) -> SegmentRecord:
    """A record without an averaging time that its own rows contradict: other loggers write the length of the segment there."""
    said_s, span_s = record.averaging_s, record.t_end_s - record.t_start_s
    if said_s is None or (said_s > 0 and (record.n - 1) * said_s <= _OVERLAPPING * span_s) or record.n < 2:
        return record
    return replace(record, averaging_s=None)


def announced(path: Path, events: Sequence[Mapping[str, Any]]) -> Iterator[SegmentRecord]:
    """Segments that the journal of the run `path` says are being sealed, in its order; raises InputError as `read_run` does."""
    source = path / "journal.jsonl"
    for number, event in enumerate(events, start=1):
        if event.get("event") == "sealing":
            yield _segment_record(source, number, event)


def _check_event(source: Path, number: int, event: Any) -> None:
    if not isinstance(event, dict):
        raise InputError(f"{source}, line {number}: is not a JSON object. {_RESTORE}")
    wrong = [
        key
        for key in ("id", "t_s", "steps", "expected_s")
        if event.get(key) is not None and not _is_number(event[key])
    ]
    if wrong:
        msg = f"{source}, line {number}: {wrong[0]} is {event[wrong[0]]!r:.40}, and a number is wanted. {_RESTORE}"
        raise InputError(msg)


def _incomplete(
    path: Path, events: list[Mapping[str, Any]], sealed: Collection[SegmentRecord]
) -> Iterator[str]:
    """What tells that the run is not all that was planned or recorded, in words."""
    starts = [i for i, e in enumerate(events) if e.get("event") in ("start", "resume")]
    said = events[starts[-1] :] if starts else []
    ends = [e for e in said if e.get("event") == "end"]
    planned = max((e["steps"] for e in events if _is_number(e.get("steps"))), default=None)
    # Others may not say that an end is one; what was planned and is lacking tells.
    if said and not (ends and ends[-1].get("complete", True)):
        aborted = next((str(e.get("reason")) for e in said if e.get("event") == "aborted"), None)
        how = (
            f"it was ended: {aborted}" if aborted else "some segments were skipped or failed" if ends else ""
        )
        known = f": {len(sealed)} of {planned:g} planned segments are sealed" if planned else ""
        yield f"the run is incomplete{known}; {how or 'its journal has no end: it goes on, was cut short, or the journal was cut'}"
    elif planned is not None and len(sealed) < planned:
        yield f"the run is incomplete: the journal says that it was completed, and has {len(sealed)} of {planned:g} segments"
    present = {f"data/{file.name}" for file in (path / "data").glob("*.csv")}
    orphans = sorted(present - {record.file for record in sealed})
    if orphans:
        yield f"{len(orphans)} files in data stand in no line of the journal and are not used (the first: {orphans[0]}); was it cut?"


def _segment_record(source: Path, number: int, event: Mapping[str, Any]) -> SegmentRecord:
    fields = SegmentRecord.__dataclass_fields__
    missing = [name for name in fields if name not in event and name != "averaging_s"]
    if missing:
        raise InputError(
            f"{source}, line {number}: the segment's {missing[0]} is missing. The journal is damaged: restore it."
        )
    for key, allowed in (("kind", KINDS), ("outcome", OUTCOMES)):
        if event[key] not in allowed:
            raise InputError(
                f"{source}, line {number}: {key} is {event[key]!r:.80}; allowed: {', '.join(allowed)}."
            )
    wrong = [
        key
        for key in ("id", "rate_dps", "chamber_c", "t_start_s", "t_end_s", "n", "averaging_s")
        if not (_is_number(event.get(key)) or (key == "averaging_s" and event.get(key) is None))
    ]
    if wrong:
        raise InputError(
            f"{source}, line {number}: the segment's {wrong[0]} is {event[wrong[0]]!r:.80}, and a number is wanted. "
            "The journal is damaged: restore it."
        )
    if not isinstance(event["file"], str) or "\0" in event["file"] or _leaves(event["file"]):
        raise InputError(
            f"{source}, line {number}: file is {event['file']!r:.80}, and a path in the run is wanted. "
            "The journal is damaged: restore it."
        )
    return SegmentRecord(
        id=int(event["id"]),
        kind=str(event["kind"]),
        rate_dps=float(event["rate_dps"]),
        chamber_c=float(event["chamber_c"]),
        t_start_s=float(event["t_start_s"]),
        t_end_s=float(event["t_end_s"]),
        n=int(event["n"]),
        averaging_s=None if event.get("averaging_s") is None else float(event["averaging_s"]),
        outcome=str(event["outcome"]),
        file=PurePosixPath(event["file"]).as_posix(),
        sha256=str(event["sha256"]),
    )
