"""For every step of a plan and every kind of failure the last motion command on the wire is a stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from gyrocal.errors import GyrocalError, StopNotVerifiedError
from tests.bench.onwire.faults import CHAMBERS, TABLES, bench_of, check_safe, refusing
from tests.bench.onwire.faulty import ChangedLine, CutLine, Span
from tests.bench.onwire.stand import WireStand
from tests.bench.test_runner import events

STEPS = range(1, 13)


def broken_program(stand: WireStand) -> None:
    def read_v() -> float:
        raise ZeroDivisionError("a bug")

    stand.bench.supply.read_v = read_v  # type: ignore[method-assign]


def full_disk(stand: WireStand) -> None:
    def full(*arguments: object, **options: object) -> None:
        raise OSError(28, "No space left on device")

    stand.bench.supply.read_v = full  # type: ignore[assignment]


#: What is done to the bench when a step begins, and whether the table's line still works afterwards.
FAILURES: dict[str, Callable[[WireStand], object]] = {
    "gyro port gone": lambda s: s.ports["gyro"].vanish(),
    "gyro silent": lambda s: s.line("gyro", CutLine()),
    "chamber port gone": lambda s: s.ports["chamber"].vanish(),
    "chamber silent": lambda s: s.line("chamber", CutLine()),
    "chamber alarm": lambda s: setattr(s.chamber, "_reading", lambda r: replace(r, alarms=("door open",))),
    "table refuses for a while": lambda s: s.line(
        "table", ChangedLine(refusing, Span(0.0, s.clock.now_s() + 15.0))
    ),
    "table silent for a while": lambda s: s.line("table", CutLine(Span(0.0, s.clock.now_s() + 15.0))),
    "table fault": lambda s: setattr(s.table, "_fault", lambda t_s: ("overload",)),
    "SIGTERM": lambda s: s.requests.ask(2, "SIGTERM"),
    "SIGHUP": lambda s: s.requests.ask(2, "SIGHUP"),
    "Ctrl-C twice": lambda s: s.requests.ask(2, "Ctrl-C twice"),
    "a bug": broken_program,
    "disk full": full_disk,
}


def fail_in_step(tmp_path: Path, step: int, name: str, table: str) -> None:
    """Run until a step begins, let it fail, and look at the wire."""
    struck = [False]

    def at(stand: WireStand, now_s: float) -> None:
        if not struck[0] and stand.steps_begun >= step:
            struck[0] = True
            FAILURES[name](stand)

    chamber = CHAMBERS[(step + list(FAILURES).index(name)) % len(CHAMBERS)]
    stand = WireStand(
        tmp_path / "r", at=at, retry__attempts=0, retry__then="stop", **bench_of(table, chamber)
    )
    if (name, table) == ("table fault", "aerosmith"):  # which its protocol does not tell
        assert stand.run().complete
    else:
        with pytest.raises((GyrocalError, ZeroDivisionError, OSError)) as caught:
            stand.run()
        assert not isinstance(caught.value, StopNotVerifiedError), str(caught.value)
    assert struck[0]
    check_safe(stand, chamber_told=not name.startswith(("chamber port", "chamber silent")))
    assert events(stand.out, "make_safe")[0]["table_stopped"] is True


@pytest.mark.parametrize("step", STEPS)
def test_the_last_motion_command_is_a_stop(tmp_path: Path, step: int) -> None:
    names = list(FAILURES)
    fail_in_step(tmp_path, step, names[(step * 5) % len(names)], TABLES[step % len(TABLES)])


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize("name", FAILURES)
def test_the_last_motion_command_is_a_stop_for_every_failure(
    tmp_path: Path, name: str, table: str, step: int
) -> None:
    fail_in_step(tmp_path, step, name, table)


def test_these_are_more_than_500() -> None:
    assert len(FAILURES) * len(STEPS) * len(TABLES) >= 500
