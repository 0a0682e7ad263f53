"""Writer of a run directory: nothing that was sealed is ever lost, whatever instant the power goes.

Order of a segment: rows to ``.part`` -> fsync -> line "sealing" in the journal (with the sha256) -> rename ->
line "segment". Whoever resumes finds, for every segment, either its line, or a file whose sha256 says that it
was whole, or a ``.part`` to be discarded.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gyrocal.errors import InputError, OutputError
from gyrocal.records.files import (
    fsync_directory,
    make_output_directory,
    raise_output_error,
    reading,
    sha256_of_file,
    write_atomically,
)
from gyrocal.records.run import COLUMNS, SegmentRecord, announced, read_run

try:
    import fcntl
except ImportError:  # a system without POSIX locks: two writers are then not kept apart
    fcntl = None  # type: ignore[assignment]

#: What this program writes under ``data``; anything else there is the user's and is left alone.
_SEGMENT_NAME = re.compile(r"\d{4,}_.*\.csv(\.part)?")
#: What a full disk leaves of a run.
_RESUME = "what was sealed is kept. Free some space and carry on with --resume"


def segment_file(number: int, kind: str, rate_dps: float, chamber_c: float) -> str:
    """Name of a segment's file, relative to the run directory (formats.md)."""
    return f"data/{number:04d}_{kind}_{rate_dps + 0.0:+08.3f}dps_{chamber_c + 0.0:+06.1f}C.csv"


@dataclass(frozen=True)
class Recovered:
    """What was found when a run was opened again."""

    sealed: dict[int, str]
    last_t_s: float
    highest_id: int
    resumed: int
    adopted: tuple[str, ...]
    discarded: tuple[str, ...]


class RunWriter:
    """The open journal of a run directory; hold it in a ``with`` statement."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._fd = os.open(path / "journal.jsonl", os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        except OSError as error:
            raise_output_error(path / "journal.jsonl", error, _RESUME)
        try:
            if fcntl is not None:
                fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(self._fd)
            msg = f"{path}: another gyrocal is writing this run. Wait for it, or end it first."
            raise OutputError(msg) from error

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._fd)

    def event(self, event: str, t_s: float, *, durable: bool = True, **details: Any) -> None:
        """Append one line, fsynced; `t_s` in seconds since the run began.

        A line that is not `durable` by itself becomes so with the next one that is.
        """
        entry = {"event": event, "t_s": round(t_s, 6), **details}
        # JSON has no NaN: what is not a number is null.
        line = json.dumps({k: None if v != v else v for k, v in entry.items()}, allow_nan=False)
        try:
            whole = os.fstat(self._fd).st_size
            try:
                write_all(self._fd, line.encode() + b"\n")
            except OSError:
                os.ftruncate(self._fd, whole)  # half a line would spoil the next one
                raise
            if durable:
                os.fsync(self._fd)
        except OSError as error:
            raise_output_error(self.path / "journal.jsonl", error, _RESUME)

    def begin_segment(self, number: int, kind: str, rate_dps: float, chamber_c: float) -> SegmentWriter:
        """Open the ``.part`` of a segment."""
        return SegmentWriter(self, number, kind, rate_dps, chamber_c)


class SegmentWriter:
    """A segment that is being recorded. Sealed by `seal`, or left as ``.part`` for the next start to discard."""

    def __init__(self, run: RunWriter, number: int, kind: str, rate_dps: float, chamber_c: float) -> None:
        self._run = run
        self._entry: dict[str, Any] = {
            "id": number,
            "kind": kind,
            "rate_dps": rate_dps,
            "chamber_c": chamber_c,
        }
        self.file = segment_file(number, kind, rate_dps, chamber_c)
        self._final = run.path / self.file
        self._part = self._final.with_name(self._final.name + ".part")
        self._digest = hashlib.sha256()
        try:
            self._fd = os.open(self._part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
        except OSError as error:
            raise_output_error(self._part, error, _RESUME)
        self.append(",".join(COLUMNS) + "\n")

    def append(self, text: str) -> None:
        """Write whole rows."""
        data = text.encode("ascii")
        try:
            write_all(self._fd, data)
        except OSError as error:
            raise_output_error(self._part, error, _RESUME)
        self._digest.update(data)

    def seal(
        self, *, t_start_s: float, t_end_s: float, n: int, averaging_s: float | None, outcome: str
    ) -> dict[str, Any]:
        """fsync, announce, rename, journal; returns the journal line."""
        entry: dict[str, Any] = {
            **self._entry,
            "t_start_s": round(t_start_s, 6),
            "t_end_s": round(t_end_s, 6),
            "n": n,
            "averaging_s": averaging_s,
            "outcome": outcome,
            "file": self.file,
            "sha256": self._digest.hexdigest(),
        }
        try:
            os.fsync(self._fd)
            os.close(self._fd)
            self._fd = -1
            self._run.event("sealing", t_end_s, **entry)
            os.rename(self._part, self._final)
            fsync_directory(self._final.parent)
        except OSError as error:
            raise_output_error(self._final, error, _RESUME)
        self._run.event("segment", t_end_s, **entry)
        return entry

    def abandon(self) -> None:
        """Close without sealing: the ``.part`` stays until the next start discards it."""
        if self._fd >= 0:
            with contextlib.suppress(OSError):
                os.close(self._fd)
            self._fd = -1


def write_all(fd: int, data: bytes) -> None:
    """Write every byte: the operating system may take fewer at a time, on a full disk for example."""
    while data:
        data = data[os.write(fd, data) :]


def create_run(path: Path, head: Mapping[str, Any]) -> RunWriter:
    """Make a run directory with `head` frozen as its ``run.json``, and open its journal.

    ``run.json`` comes last: where it is, everything else is.

    Raises
    ------
    OutputError
        The directory holds files already, cannot be written, or the disk is full.
    """
    make_output_directory(path, may_hold_files=is_stillborn(path))
    try:
        (path / "data").mkdir(exist_ok=True)
    except OSError as error:
        raise_output_error(path / "data", error)
    writer = RunWriter(path)
    try:
        # Only now is it sure that nobody else is writing them.
        for stale in path.glob(".run.json.*.part"):
            stale.unlink()
        text = json.dumps(head, indent=1, allow_nan=False)
        write_atomically(path / "run.json", text + "\n")
        fsync_directory(path.parent)
    except BaseException:
        writer.__exit__()
        raise
    return writer


def is_stillborn(path: Path) -> bool:
    """Whether `path` is what a crash leaves before ``run.json`` was written: an empty shell of a run."""
    if not path.is_dir():
        return False
    for entry in path.iterdir():
        shell = (
            (entry.name == "data" and entry.is_dir() and not any(entry.iterdir()))
            or (entry.name == "journal.jsonl" and entry.stat().st_size == 0)
            or (entry.name.startswith(".run.json.") and entry.suffix == ".part")
        )
        if not shell:
            return False
    return True


def resume_run(path: Path) -> tuple[RunWriter, Recovered]:
    """Open a run's journal again and mend what a crash left: a torn line, a rename without its line, ``.part`` files.

    Raises
    ------
    InputError
        The journal is damaged elsewhere than at its end, or a sealed file is missing or changed.
    OutputError
        Another program is writing this run, or the directory cannot be written.
    """
    writer = RunWriter(path)
    try:
        return writer, _recover(path, writer)
    except BaseException:
        writer.__exit__()
        raise


def _recover(path: Path, writer: RunWriter) -> Recovered:
    _cut_torn_line(path / "journal.jsonl")
    run = read_run(path)
    for record in run.segments:
        run.verify(record)
    sealed = {record.id: record for record in run.segments}
    sealing = list(announced(path, run.events))
    _refuse_unknown(path, {record.file for record in (*run.segments, *sealing)})
    adopted = []
    for record in sealing:
        if record.id not in sealed and _adopt(path, record):
            writer.event("segment", record.t_end_s, **asdict(record))
            sealed[record.id] = record
            adopted.append(record.file)
    return Recovered(
        sealed={number: record.outcome for number, record in sealed.items()},
        last_t_s=max((float(e["t_s"]) for e in run.events if e.get("t_s") is not None), default=0.0),
        highest_id=max((int(e["id"]) for e in run.events if e.get("id") is not None), default=0),
        resumed=sum(e.get("event") == "resume" for e in run.events),
        adopted=tuple(adopted),
        discarded=_discard(path, {record.file for record in sealed.values()}),
    )


def _refuse_unknown(path: Path, known: set[str]) -> None:
    """Refuse segments that no line of the journal speaks of: a file gets its name after its line, so the line was lost."""
    with reading(path / "data"):
        names = sorted(file.name for file in (path / "data").iterdir())
    unknown = [
        n
        for n in names
        if _SEGMENT_NAME.fullmatch(n) and not n.endswith(".part") and f"data/{n}" not in known
    ]
    if unknown:
        msg = (
            f"{path}: {len(unknown)} files in data stand in no line of the journal (the first: data/{unknown[0]}), which was cut. "
            "Restore the journal, or move them elsewhere to record them again; nothing was changed."
        )
        raise InputError(msg)


def _cut_torn_line(journal: Path) -> None:
    """Take away a last line without its end: its write was interrupted."""
    with reading(journal):
        raw = journal.read_bytes()
    whole = raw.rfind(b"\n") + 1
    if whole < len(raw):
        try:
            with journal.open("r+b") as f:
                f.truncate(whole)
                os.fsync(f.fileno())
        except OSError as error:
            raise_output_error(journal, error)


def _adopt(path: Path, record: SegmentRecord) -> bool:
    """Finish the sealing of a file that was announced: whole by its sha256, renamed or not yet."""
    final = path / record.file
    part = final.with_name(final.name + ".part")
    source = final if final.exists() else part
    if not source.exists() or sha256_of_file(source) != record.sha256:
        return False
    try:
        if source == part:
            os.rename(part, final)
        fsync_directory(final.parent)
    except OSError as error:
        raise_output_error(final, error)
    return True


def _discard(path: Path, sealed: set[str]) -> tuple[str, ...]:
    """Remove what no journal line vouches for; its steps are done again."""
    gone = []
    try:
        for file in sorted((path / "data").iterdir()):
            if _SEGMENT_NAME.fullmatch(file.name) and f"data/{file.name}" not in sealed:
                file.unlink()
                gone.append(f"data/{file.name}")
        fsync_directory(path / "data")
    except OSError as error:
        raise_output_error(path / "data", error)
    return tuple(gone)
