"""On every way out the last motion command is a stop, and its read-back is believed only when it confirms."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from gyrocal.bench.devices import TableReading
from gyrocal.bench.safety import StopRequests, listening
from gyrocal.errors import (
    DeviceError,
    GyrocalError,
    InterruptedRunError,
    OutputError,
    StopNotVerifiedError,
)
from tests.bench.test_runner import events
from tests.bench.tiny import Stand

CALLS = ("gyro.drain", "table.read", "table.set_rate", "chamber.read", "chamber.set_setpoint")
STEPS = range(1, 13)


class Bomb:
    """Raises at the first call of a name within a step: a device three times, as often as it is asked."""

    def __init__(self, call: str, step: int, error: BaseException) -> None:
        self.call, self.step, self.error = call, step, error
        self.stand: Stand
        self.left = 3 if isinstance(error, DeviceError) else 1

    def __call__(self, call: str) -> None:
        seen = self.stand.watch.seen
        if self.left and call == self.call and seen and seen[-1].step.id >= self.step:
            self.left -= 1
            raise self.error


ERRORS: dict[str, Callable[[], BaseException]] = {
    "device": lambda: DeviceError("gone"),
    "bug": lambda: ZeroDivisionError("a driver's bug"),
    "os": lambda: OSError("port vanished"),
    "interrupt": lambda: KeyboardInterrupt(),
}


#: Every step with one kind of failure; the other kinds take the same way out and are tried in a few steps.
WAYS_OUT = [(step, "device") for step in STEPS] + [(s, k) for s in (2, 4) for k in ERRORS if k != "device"]


@pytest.mark.parametrize(("step", "kind"), WAYS_OUT)
def test_for_every_step_and_failure_the_last_motion_command_is_a_stop(
    tmp_path: Path, step: int, kind: str
) -> None:
    hit = 0
    for call in CALLS:
        bomb = Bomb(call, step, ERRORS[kind]())
        stand = bomb.stand = Stand(tmp_path / call, bomb)
        try:
            stand.run()
        except BaseException as error:
            # Set for the last time in making safe, the chamber is all that is lost.
            if error is not bomb.error and "the chamber was lost at its end" not in str(error):
                raise
            hit += 1
        assert stand.table.motions[-1] == "stop", f"{call} in step {step}"
        assert stand.chamber.setpoints[-1] == 22.0
        stand.clock.sleep(0.2)
        assert stand.bench.table.read().rate_dps == 0.0
        if not (kind == "interrupt" and call == "chamber.set_setpoint"):
            # without `listening` an interrupt may come while making safe: after the stop
            assert events(tmp_path / call, "make_safe")[0]["table_stopped"] is True
    # set_setpoint is not called after the last soak; all else is, in every step
    assert hit >= 4


@pytest.mark.parametrize("step", STEPS)
def test_operator_and_system_end_it_safely(tmp_path: Path, step: int) -> None:
    for level in (1, 2):
        stand = Stand(tmp_path / f"r{level}")

        def ask(call: str, stand: Stand = stand, level: int = level) -> None:
            if stand.watch.seen and stand.watch.seen[-1].step.id >= step:
                stand.requests.ask(level, "SIGTERM")

        stand.table.before = ask
        # one Ctrl-C during the last data set lets it finish, and then the run is over anyway
        if (step, level) == (12, 1):
            assert stand.run().complete
        else:
            with pytest.raises(InterruptedRunError):
                stand.run()
        assert stand.table.motions[-1] == "stop"


def test_a_full_disk_ends_it_safely(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from gyrocal.records import journal

    stand = Stand(tmp_path / "r")
    real = journal.write_all

    def full(fd: int, data: bytes) -> None:
        if stand.watch.seen and stand.watch.seen[-1].step.id >= 4:
            os.write(fd, data[: len(data) // 2])
            raise OSError(28, "No space left on device")
        real(fd, data)

    monkeypatch.setattr(journal, "write_all", full)
    with pytest.raises(OutputError, match=r"the disk is full; what was sealed is kept.*--resume") as caught:
        stand.run()
    assert caught.value.__notes__ == ["The table stands. The chamber is set to 22 °C."]
    assert stand.table.motions[-1] == "stop"
    assert stand.world.read_table()[0] == 0.0
    # half a line of the journal was taken back
    assert (tmp_path / "r" / "journal.jsonl").read_text().endswith("}\n")


@pytest.mark.parametrize(
    "lie",
    [
        lambda r: replace(r, rate_dps=5.0),  # does not stop
        lambda r: replace(r, rate_dps=0.0, angle_deg=10.0 * r.t_s),  # says so, but its angle moves
        lambda r: replace(r, rate_dps=float("nan")),  # says nothing
        lambda r: replace(r, t_s=r.t_s - 1000.0),  # repeats an old answer
    ],
)
def test_an_unconfirmed_stop_is_said_loudly(
    tmp_path: Path, lie: Callable[[TableReading], TableReading]
) -> None:
    stand = Stand(tmp_path / "r")
    turning = [False]

    def falsify(reading: TableReading) -> TableReading:
        turning[0] = turning[0] or bool(stand.table.motions and stand.table.motions[-1] == "stop")
        return lie(reading) if turning[0] else reading

    stand.table.falsify = falsify
    with pytest.raises(
        StopNotVerifiedError, match=r"(?m)^THE TABLE MAY STILL BE TURNING: .*emergency stop now\.$"
    ):
        stand.run()
    # told again and again until the deadline: 30 s and 8 s of braking, every half second
    assert stand.table.motions.count("stop") >= 70
    assert stand.chamber.setpoints[-1] == 22.0
    assert events(tmp_path / "r", "make_safe")[0]["table_stopped"] is False


def test_a_table_that_cannot_be_read_is_stopped_all_the_same(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")

    def dead(call: str) -> None:
        if call == "table.read" and stand.watch.seen and stand.watch.seen[-1].step.id >= 4:
            raise DeviceError("no answer")

    stand.table.before = dead
    with pytest.raises(
        StopNotVerifiedError, match=r"(?m)its last read-back was nothing.* before: no answer$"
    ) as caught:
        stand.run()
    assert caught.value.__notes__ == ["The chamber is set to 22 °C."]
    assert events(tmp_path / "r", "aborted")[0]["reason"] == str(caught.value)
    assert isinstance(caught.value.__context__, DeviceError)
    assert stand.world.read_table()[0] == 0.0


LOUD = "THE CHAMBER MAY NOT BE SAFE: it did not take its safe set point (chamber gone). Set it by hand now."


def test_a_chamber_that_is_lost_at_the_very_end_is_said_loudly(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")

    def dead(call: str) -> None:
        if call == "chamber.set_setpoint" and stand.chamber.setpoints[-1] == 22.0:
            raise DeviceError("chamber gone.")

    stand.chamber.before = dead
    with pytest.raises(DeviceError, match=r"^The plan is done, and the chamber was lost") as caught:
        stand.run()
    assert caught.value.__notes__ == [f"The table stands. {LOUD}"]


def test_every_early_end_says_how_the_bench_was_left(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    stand.table.before = lambda call: stand.requests.ask(2, "SIGTERM") if stand.watch.seen else None
    with pytest.raises(InterruptedRunError) as caught:
        stand.run()
    assert caught.value.__notes__ == ["The table stands. The chamber is set to 22 °C."]


def test_a_dead_chamber_does_not_keep_the_table_from_stopping(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")

    def dead(call: str) -> None:
        if call.startswith("chamber") and stand.watch.seen and stand.watch.seen[-1].step.id >= 4:
            raise DeviceError("chamber gone")

    stand.chamber.before = dead
    with pytest.raises(DeviceError, match="chamber gone") as caught:
        stand.run()
    assert caught.value.__notes__ == [f"The table stands. {LOUD}"]
    (line,) = events(tmp_path / "r", "make_safe")
    assert line["table_stopped"] is True
    assert line["chamber_setpoint_c"] is None
    assert line["chamber_error"] == "chamber gone"


def test_a_stop_that_no_byte_of_went_out_is_not_said_to_have_been_told(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")

    def dead(call: str) -> None:
        if call.startswith("table") and stand.watch.seen and stand.watch.seen[-1].step.id >= 4:
            raise DeviceError("there is no such port.")

    stand.table.before = dead
    stand.table.send_stop = lambda: dead("table.send_stop")  # type: ignore[method-assign]
    said = r"TURNING: for 38 s no stop could be sent to it \(there is no such port\). Use its emergency stop"
    with pytest.raises(StopNotVerifiedError, match=said):
        stand.run()


def test_the_chamber_gets_alarm_limits_of_its_own(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    told: list[tuple[float, float]] = []
    stand.chamber.set_alarm_limits = lambda low_c, high_c: told.append((low_c, high_c))  # type: ignore[method-assign]
    stand.run()
    assert told == [(-45.0, 80.0)]


def test_a_chamber_that_fails_to_start_is_made_safe_too(tmp_path: Path) -> None:
    def fail(call: str) -> None:
        if call == "chamber.start":
            raise DeviceError("not there")

    stand = Stand(tmp_path / "r", fail)
    with pytest.raises(GyrocalError, match="not there"):
        stand.run()
    assert stand.table.motions == ["stop"] * len(stand.table.motions) != []


def test_a_table_that_never_turned_and_does_not_know_its_rate_is_no_emergency(tmp_path: Path) -> None:
    def fail(call: str) -> None:
        if call == "gyro.start":
            raise DeviceError("no byte came")

    stand = Stand(tmp_path / "r", fail)
    stand.table.falsify = lambda reading: replace(
        reading, rate_dps=float("nan")
    )  # a manual one, not answered for yet
    with pytest.raises(DeviceError, match="no byte came") as caught:
        stand.run()
    assert caught.value.__notes__ == [
        "The table was given no rate and does not say whether it stands. The chamber is set to 22 °C."
    ]


def test_a_bug_stands_in_the_journal_too(tmp_path: Path) -> None:
    def fail(call: str) -> None:
        if call == "chamber.read":
            raise ZeroDivisionError("a driver's bug")

    with pytest.raises(ZeroDivisionError):
        Stand(tmp_path / "r", fail).run()
    (line,) = events(tmp_path / "r", "aborted")
    assert (line["error"], line["reason"]) == ("ZeroDivisionError", "a driver's bug")


def test_a_signal_ends_a_question_to_the_operator() -> None:
    requests = StopRequests()

    def nobody(question: str) -> str:
        os.kill(os.getpid(), signal.SIGTERM)
        return "the answer of hours later"

    with listening(requests):
        with pytest.raises(InterruptedRunError, match="Ended by SIGTERM"):
            requests.heeding(nobody)("Set the table: ")
        # what makes the bench safe has to ask all the same, and then no signal is left to end it
        assert requests.heeding(lambda question: "0")("STOP: ") == "0"
        os.kill(os.getpid(), signal.SIGTERM)


@pytest.mark.parametrize(
    ("signals", "level", "reason"),
    [
        ([signal.SIGINT], 1, "Ctrl-C"),
        ([signal.SIGINT, signal.SIGINT], 2, "Ctrl-C twice"),
        ([signal.SIGTERM], 2, "SIGTERM"),
        ([signal.SIGHUP], 2, "SIGHUP"),
        ([signal.SIGQUIT], 2, "SIGQUIT"),
        ([signal.SIGUSR1], 2, "SIGUSR1"),
        ([signal.SIGXCPU], 2, "SIGXCPU"),
        ([signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU], 0, ""),
        ([signal.SIGTERM, signal.SIGINT], 2, "SIGTERM"),
    ],
)
def test_signals_become_requests(signals: list[signal.Signals], level: int, reason: str) -> None:
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP, signal.SIGUSR1)
    before = [signal.getsignal(s) for s in numbers]
    requests = StopRequests()
    with listening(requests):
        for number in signals:
            os.kill(os.getpid(), number)
    assert (requests.level, requests.reason) == (level, reason)
    assert [signal.getsignal(s) for s in numbers] == before


def test_a_run_that_was_started_to_outlive_its_terminal_does() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
    requests = StopRequests()
    try:
        with listening(requests):
            os.kill(os.getpid(), signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)
    assert requests.level == 0


def test_a_table_that_stands_where_its_angle_begins_anew_is_seen_to_stand(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    reads = [0]

    def at_home(reading: TableReading) -> TableReading:
        if abs(reading.rate_dps) > 1e-9:
            return reading
        reads[0] += 1
        return replace(reading, angle_deg=0.0004 if reads[0] % 2 else 359.9996)

    stand.table.falsify = at_home
    stand.run()
    assert events(tmp_path / "r", "make_safe")[0]["table_stopped"] is True
