"""Killed at any instant and started again, a run ends as an undisturbed one in its plan and its outcome."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gyrocal.bench.session import AcquireConfig, acquire
from gyrocal.bench.status import read_status
from gyrocal.errors import InputError, InterruptedRunError, OutputError, ProfileError
from gyrocal.records import files, journal
from gyrocal.records.files import sha256_of_file
from gyrocal.records.run import read_run
from tests.bench.test_runner import events
from tests.bench.tiny import Silent, tiny

#: What the writer asks of the operating system; a program may die before, after, and in the middle of each.
OPERATIONS = ("open", "write", "fsync", "rename")
MOMENTS = ("before", "torn", "after")


class Killed(BaseException):
    """The program is dead: nothing that it does from now on reaches the disk."""


class Disk:
    """The module `os` as the writer sees it, until the operation number `last`."""

    def __init__(self, last: int = 10**9, moment: str = "before") -> None:
        self.count, self.last, self.moment = 0, last, moment

    def __getattr__(self, name: str) -> Any:
        real = getattr(os, name)
        if name not in OPERATIONS:
            return real

        def operation(*arguments: Any, **options: Any) -> Any:
            self.count += 1
            if self.count > self.last or (self.count == self.last and self.moment == "before"):
                raise Killed
            if self.count < self.last:
                return real(*arguments, **options)
            if self.moment == "torn" and name == "write":
                real(arguments[0], arguments[1][: len(arguments[1]) // 2])
            elif self.moment == "after" or name != "write":
                real(*arguments, **options)
            raise Killed

        return operation


def toml(table: dict[str, Any], path: str = "") -> str:
    """The tiny profile as TOML."""
    plain = {k: v for k, v in table.items() if not isinstance(v, dict)}
    lines = [f"[{path}]"] if path else []
    for key, value in plain.items():
        lines.append(f"{key} = {str(value).lower() if isinstance(value, bool) else repr(value)}")
    for key, value in table.items():
        if isinstance(value, dict):
            lines.append(toml(value, f"{path}.{key}" if path else key))
    return "\n".join(lines)


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    """The tiny profile on disk."""
    path = tmp_path / "tiny.toml"
    path.write_text(toml(tiny()))
    return path


def start(profile: Path, out: Path, *, resume: bool = False) -> None:
    """One start of the program."""
    acquire(AcquireConfig(profile, out, resume=resume), Silent())


def check_completed(out: Path, undisturbed: Path) -> None:
    """Every step of the plan once, with the outcome of the undisturbed run; nothing left over."""
    run, other = read_run(out), read_run(undisturbed)
    plan = {(s.id, s.kind, s.rate_dps, s.chamber_c, s.outcome) for s in other.segments}
    planned = [s for s in run.segments if s.id <= len(plan)]
    assert {(s.id, s.kind, s.rate_dps, s.chamber_c, s.outcome) for s in planned} == plan
    assert all(s.kind in ("ramp", "soak") and s.outcome == "ok" for s in run.segments if s.id > len(plan))
    lines = [e["id"] for e in run.events if e["event"] == "segment"]
    assert len(lines) == len(set(lines)), "a segment was sealed twice"
    assert {f"data/{p.name}" for p in (out / "data").iterdir()} == {s.file for s in run.segments}
    for segment in run:  # reads all, verifies each sha256 and the order of time
        if segment.record.kind == "rate":
            assert segment.record.n == 30
    times = [(s.t_start_s, s.t_end_s) for s in run.segments]
    assert all(a[1] <= b[0] for a, b in zip(times, times[1:], strict=False))  # noqa: RUF007
    # whatever follows an interruption was soaked before
    order = [s.kind for s in run.segments]
    assert "rate" not in order[: order.index("soak")]
    assert events(out, "end")[-1]["complete"] is True


def kill_and_resume(
    monkeypatch: pytest.MonkeyPatch, profile: Path, out: Path, last: int, moment: str
) -> None:
    """Die at an operation, then carry on with a sound disk; sealed segments must outlive it untouched."""
    with monkeypatch.context() as patch:
        disk = Disk(last, moment)
        patch.setattr(journal, "os", disk)
        patch.setattr(files, "os", disk)
        with pytest.raises(Killed):
            start(profile, out)
    begun = (out / "run.json").exists()
    before = {s.file: s.sha256 for s in read_run(out).segments} if begun else {}
    start(profile, out, resume=begun)
    after = {s.file: s.sha256 for s in read_run(out).segments}
    for file, digest in before.items():
        assert after[file] == digest == sha256_of_file(out / file)


def operations_of_a_run(monkeypatch: pytest.MonkeyPatch, profile: Path, out: Path) -> int:
    """How many operations an undisturbed run makes."""
    with monkeypatch.context() as patch:
        disk = Disk()
        patch.setattr(journal, "os", disk)
        patch.setattr(files, "os", disk)
        start(profile, out)
    return disk.count


def run_through(
    monkeypatch: pytest.MonkeyPatch, profile: Path, tmp_path: Path, stride: int, shift: int
) -> None:
    """Die at every `stride`-th operation, each time at another moment of it."""
    n = operations_of_a_run(monkeypatch, profile, tmp_path / "whole")
    assert n > 100
    for tried, last in enumerate(range(1, n + 1, stride)):
        out = tmp_path / "killed"
        kill_and_resume(monkeypatch, profile, out, last, MOMENTS[(tried + shift) % 3])
        check_completed(out, tmp_path / "whole")
        shutil.rmtree(out)


def test_killed_at_many_instants(monkeypatch: pytest.MonkeyPatch, profile: Path, tmp_path: Path) -> None:
    run_through(monkeypatch, profile, tmp_path, 13, 0)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("shift", range(3))
def test_killed_at_every_instant(
    monkeypatch: pytest.MonkeyPatch, profile: Path, tmp_path: Path, shift: int
) -> None:
    run_through(monkeypatch, profile, tmp_path, 1, shift)


def test_killed_again_while_resuming(monkeypatch: pytest.MonkeyPatch, profile: Path, tmp_path: Path) -> None:
    start(profile, tmp_path / "whole")
    out = tmp_path / "r"
    for last in (40, 47, 59, 31, 83):
        with monkeypatch.context() as patch:
            disk = Disk(last, "torn")
            patch.setattr(journal, "os", disk)
            patch.setattr(files, "os", disk)
            with pytest.raises(Killed):
                start(profile, out, resume=(out / "run.json").exists())
    start(profile, out, resume=True)
    check_completed(out, tmp_path / "whole")
    assert len(events(out, "resume")) == 5


def kill_process_and_resume(tmp_path: Path, delays_s: list[float]) -> int:
    """SIGKILL after each delay, then resume to the end; returns how many kills met a living run."""
    out, whole = tmp_path / "killed", tmp_path / "whole"
    path = tmp_path / "p.toml"
    # long enough to be killed in the middle: 40 data sets
    path.write_text(toml(tiny(plan__rates_dps=[5.0 * k for k in range(1, 20)])))
    start(path, whole)
    met = 0
    command = [sys.executable, "-m", "gyrocal", "acquire", str(path), "--out", str(out)]
    for delay_s in delays_s:
        begun = ["--resume"] if (out / "run.json").exists() else []
        process = subprocess.Popen([*command, *begun], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + 30.0
        while not (out / "run.json").exists() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.01)
        time.sleep(delay_s)
        met += process.poll() is None
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal.SIGKILL)
        process.wait()
    start(path, out, resume=True)
    check_completed(out, whole)
    return met


def test_kill_minus_nine(tmp_path: Path) -> None:
    assert kill_process_and_resume(tmp_path, [0.02, 0.15]) >= 1


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("round_", range(40))
def test_kill_minus_nine_often(tmp_path: Path, round_: int) -> None:
    # 40 rounds of 5 kills: 200 instants, no two alike.
    delays = [0.01 + 0.37 * (40 * k + round_) / 200 for k in (2, 0, 4, 1, 3)]
    kill_process_and_resume(tmp_path, delays)


def changed(profile: Path, change: Callable[[str], str]) -> Path:
    """The profile with another text."""
    profile.write_text(change(profile.read_text()))
    return profile


def test_a_changed_profile_is_refused(profile: Path, tmp_path: Path) -> None:
    start(profile, tmp_path / "r")
    before = (tmp_path / "r" / "journal.jsonl").read_bytes()
    changed(profile, lambda text: text.replace("dwell_s = 3.0", "dwell_s = 4.0"))
    with pytest.raises(OutputError) as caught:
        start(profile, tmp_path / "r", resume=True)
    assert str(caught.value) == (
        f"tiny.toml: differs from the profile that {tmp_path / 'r'} was begun with: plan.dwell_s was 3.0 and is 4.0. "
        "Carry on with the old profile, or start a new run with another --out."
    )
    assert (tmp_path / "r" / "journal.jsonl").read_bytes() == before


def test_comments_do_not_count_as_a_change(profile: Path, tmp_path: Path) -> None:
    start(profile, tmp_path / "r")
    start(changed(profile, lambda text: "# a word\n" + text), tmp_path / "r", resume=True)


def test_the_seed_of_the_command_line_is_remembered(profile: Path, tmp_path: Path) -> None:
    out = tmp_path / "r"
    acquire(AcquireConfig(profile, out, seed=7), Silent())
    start(profile, out, resume=True)
    with pytest.raises(OutputError, match=r"virtual\.seed was 7 and is 8"):
        acquire(AcquireConfig(profile, out, seed=8, resume=True), Silent())


def test_a_run_is_not_begun_over_another(profile: Path, tmp_path: Path) -> None:
    start(profile, tmp_path / "r")
    with pytest.raises(OutputError, match=r"holds a run already\. Add --resume"):
        start(profile, tmp_path / "r")


@pytest.mark.parametrize("name", ["nothing", "empty", "notes"])
def test_there_must_be_a_run_to_carry_on(profile: Path, tmp_path: Path, name: str) -> None:
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "x").write_text("mine")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"there is no run to carry on.*leave --resume out"):
        start(profile, tmp_path / name, resume=True)
    assert not (tmp_path / name / "run.json").exists()


def test_a_bad_profile_makes_no_directory(tmp_path: Path, profile: Path) -> None:
    changed(profile, lambda text: text.replace("dwell_s = 3.0", "dwell_s = -3.0"))
    with pytest.raises(ProfileError):
        start(profile, tmp_path / "r")
    assert not (tmp_path / "r").exists()


def test_interrupted_then_resumed_says_what_happened(
    profile: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from gyrocal.bench.safety import StopRequests
    from gyrocal.cli.acquired import show_summary

    requests = StopRequests()

    class Impatient(Silent):
        def progress(self, progress: Any) -> None:
            if progress.step.id == 5:
                requests.ask(1, "Ctrl-C")

    with pytest.raises(InterruptedRunError):
        acquire(AcquireConfig(profile, tmp_path / "r"), Impatient(), requests)
    summary = acquire(AcquireConfig(profile, tmp_path / "r", resume=True), Silent())
    assert summary.before == 5
    assert summary.recorded == 12
    assert summary.brought_back == 2  # the extra ramp and soak
    show_summary(tmp_path / "r", summary)
    said = capsys.readouterr().out
    assert (
        "(5 of them before this start). 2 more beside the plan, in which the bench was brought back" in said
    )
    assert "\nOf this start: bench time " in said
    (line,) = events(tmp_path / "r", "resume")
    assert line["left"] == 7
    assert line["virtual_world"] == "restarted at 21 deg C, table at rest"
    # Another terminal counts the same, and so does a start that finds nothing left.
    for other in (
        read_status(tmp_path / "r"),
        acquire(AcquireConfig(profile, tmp_path / "r", resume=True), Silent()),
    ):
        assert (other.recorded, other.brought_back) == (12, 2)
    assert read_status(tmp_path / "r").steps == 12


def test_the_same_seed_gives_the_same_bytes(profile: Path, tmp_path: Path) -> None:
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        acquire(AcquireConfig(profile, tmp_path / name, seed=seed), Silent())

    def contents(name: str) -> dict[str, bytes]:
        folder = tmp_path / name
        return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}

    assert contents("a") == contents("b")
    assert contents("a") != contents("c")
