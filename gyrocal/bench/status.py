"""Where a run is, read from its directory alone: nothing is locked, written or asked of the program that records."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gyrocal.bench.plan import Bound, Limits, make_plan
from gyrocal.bench.profile import Profile, profile_from_dict
from gyrocal.errors import GyrocalError
from gyrocal.records.files import reading
from gyrocal.records.run import read_run

#: How much of the end of a segment that is being recorded is looked at.
_TAIL_BYTES = 65536
_LAST_EVENTS = 8
_FAR = 1e9


@dataclass(frozen=True)
class Status:
    """Where a run is.

    Attributes
    ----------
    state : str
        ``running``, ``complete``, ``incomplete`` (ended, with segments failed or skipped), ``stopped`` (ended early,
        the bench made safe), or ``dead`` (nothing was said: the program or the computer died).
    reason : str or None
        Why it stopped.
    steps, recorded, unsettled, failed, retried : int
        Steps of the plan, and what became of those that were sealed; attempts done again.
    brought_back : int
        Segments beside the plan, in which a start brought the bench back to a temperature.
    now : str or None
        What is being recorded.
    left_s : float
        Bench time that the steps left are expected to take; NaN where the profile is unknown.
    chamber_c, gyro_c, table_dps : float
        Last readings; NaN where there are none. Of the table that of its stop, once it was made safe.
    made_safe : dict or None
        How the last start left the bench: ``table_stopped``, ``table_rate_dps``, ``chamber_setpoint_c``, ``chamber_error``;
        None while it goes on, and where it died.
    quiet_s : float
        Since the run's files changed last, s by the wall clock.
    events : tuple of dict
        The last lines of the journal.
    """

    state: str
    reason: str | None
    steps: int
    recorded: int
    unsettled: int
    failed: int
    retried: int
    brought_back: int
    now: str | None
    left_s: float
    chamber_c: float
    gyro_c: float
    table_dps: float
    made_safe: dict[str, Any] | None
    quiet_s: float
    events: tuple[dict[str, Any], ...]

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def read_status(path: Path, now: datetime | None = None) -> Status:
    """Status of a run directory, running or not.

    Raises
    ------
    InputError
        `path` holds no run, or its head or journal is damaged.
    """
    run = read_run(path)
    events = [dict(event) for event in run.events]
    sealed = {record.id: record.outcome for record in run.segments}
    part = max((path / "data").glob("*.part"), key=lambda p: p.stat().st_mtime, default=None)
    last = [path / run.segments[-1].file] if run.segments else []
    last += [part] if part else []
    readings: dict[str, float] = {}
    for segment in last:  # one that was just begun may hold nothing yet
        readings |= _last_readings(segment)
    changed_s = max(p.stat().st_mtime for p in (path / "run.json", path / "journal.jsonl", *last))
    quiet_s = (now or datetime.now(UTC)).timestamp() - changed_s
    said = _last_start(events)
    state, reason = _state(said, held=_is_held(path / "journal.jsonl"))
    safe = next((e for e in reversed(said) if e.get("event") == "make_safe"), None)
    if safe is not None:
        rate_dps = safe.get("table_rate_dps")
        readings["table_rate_dps"] = rate_dps if isinstance(rate_dps, int | float) else math.nan
    steps, left_s, planned = _plan_left(run.profile, sealed, events)
    outcomes = [outcome for number, outcome in sealed.items() if number in planned]
    return Status(
        state=state,
        reason=reason,
        steps=steps,
        recorded=outcomes.count("ok"),
        unsettled=outcomes.count("unsettled"),
        failed=outcomes.count("failed"),
        retried=sum(e.get("event") == "attempt_failed" for e in events),
        brought_back=len(sealed) - len(outcomes),
        now=part.name.removesuffix(".csv.part") if part and state == "running" else None,
        left_s=0.0 if state in ("complete", "incomplete") else left_s,
        chamber_c=readings.get("chamber_temp_c", math.nan),
        gyro_c=readings.get("gyro_temp_c", math.nan),
        table_dps=readings.get("table_rate_dps", math.nan),
        made_safe=safe,
        quiet_s=max(quiet_s, 0.0),
        events=tuple(events[-_LAST_EVENTS:]),
    )


def _last_start(events: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The journal's lines since the program was started last."""
    starts = [i for i, e in enumerate(events) if e.get("event") in ("start", "resume")]
    return events[starts[-1] :] if starts else []


def _state(said: list[dict[str, Any]], *, held: bool | None) -> tuple[str, str | None]:
    """State by the last start's own words; without an end it runs as long as its journal is held."""
    for event in reversed(said):
        if event.get("event") == "end":
            return ("complete" if event.get("complete") else "incomplete"), None
        if event.get("event") == "aborted":
            return "stopped", str(event.get("reason"))
    if held is False:
        return "dead", None
    return "running", None


def _is_held(journal: Path) -> bool | None:
    """Whether a program holds the journal's lock, from the kernel's list; None where there is no such list."""
    try:
        locks = Path("/proc/locks").read_text(encoding="ascii")
    except OSError:
        return None
    inode = str(journal.stat().st_ino)
    return any(
        words[1] == "FLOCK" and words[-3].rpartition(":")[2] == inode
        for words in map(str.split, locks.splitlines())
        if len(words) >= 4 and "->" not in words
    )


def _last_readings(segment: Path) -> dict[str, float]:
    """Last value of each column of a segment file, without reading all of it."""
    with reading(segment), segment.open("rb") as f:
        header = f.readline().decode("ascii", errors="replace").strip().split(",")
        f.seek(0, 2)
        f.seek(max(f.tell() - _TAIL_BYTES, len(",".join(header)) + 1))
        lines = f.read().split(b"\n")[:-1]
    values: dict[str, float] = {}
    for line in lines:
        cells = line.decode("ascii", errors="replace").split(",")
        if len(cells) != len(header):
            continue  # the first line may be cut
        for name, cell in zip(header, cells, strict=True):
            try:
                values[name] = float(cell)
            except ValueError:
                continue
    return values


def _plan_left(
    raw: Mapping[str, Any] | None, sealed: Mapping[int, str], events: list[dict[str, Any]]
) -> tuple[int, float, frozenset[int]]:
    """Number of steps, the expected bench time of those that are left, and the segments that are of the plan."""
    said = next((e for e in events if e.get("event") == "start"), {})
    try:
        profile = profile_from_dict(raw or {}, "run.json")
        steps = make_plan(profile, _no_limits(), _start_c(profile)).steps
    except GyrocalError:
        return int(said.get("steps", len(sealed))), math.nan, frozenset(sealed)
    expected_s = sum(step.expected_s for step in steps)
    left_s = sum(step.expected_s for step in steps if step.id not in sealed)
    # What was said at the start also knows how fast the table speeds up.
    longer = float(said.get("expected_s", expected_s)) / expected_s if expected_s else 1.0
    return len(steps), left_s * longer, frozenset(step.id for step in steps)


def _start_c(profile: Profile) -> float:
    virtual = profile.table.device == "virtual"
    return profile.virtual.start_temp_c if virtual else profile.safe.chamber_c


def _no_limits() -> Limits:
    """Limits that no plan of a running run exceeds: they were checked when it began."""
    low, high = Bound(-_FAR, "nobody"), Bound(_FAR, "nobody")
    return Limits(low, high, low, high, high, high, None)
