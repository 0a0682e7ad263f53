"""Every way out leads through here: table stopped and seen to stand, chamber to its safe set point. And interlocks."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import FrameType
from typing import Any, Protocol, TypeVar

from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import Bench, ChamberReading, RateTable, TableReading
from gyrocal.bench.plan import Limits
from gyrocal.bench.profile import Profile
from gyrocal.errors import InterlockError, InterruptedRunError, StopNotVerifiedError

T = TypeVar("T")

#: Between two stop commands, and between the two readings that have to agree, s.
_STOP_PERIOD_S = 0.5
#: How often the chamber is told its safe set point at most.
_CHAMBER_TOLD = 3
#: An encoder's own unrest between two readings at rest, deg.
_ENCODER_UNREST_DEG = 1e-3
#: A move of the chamber after which a soaked gyro's thermometer must have moved too, deg C.
_TELLING_C = 5.0


class Note(Protocol):
    """How the journal is told."""

    def __call__(self, event: str, **details: Any) -> None: ...


@dataclass
class StopRequests:
    """What the operator or the system asked for: 0 nothing, 1 end after the data set at hand, 2 end now.

    `prompting`: the program waits for the operator's answer, and a request ends that wait.
    """

    level: int = 0
    reason: str = ""
    prompting: bool = False

    def ask(self, level: int, reason: str) -> None:
        """Ask; a request is never taken back."""
        if level > self.level:
            self.level, self.reason = level, reason

    def heed(self, level: int) -> None:
        """Raise InterruptedRunError when at least this level was asked for."""
        if self.level >= level:
            msg = f"Ended by {self.reason}; what was sealed is kept, and --resume carries on."
            raise InterruptedRunError(msg)

    def heeding(self, prompt: Callable[[str], str]) -> Callable[[str], str]:
        """`prompt`, ended by a signal that comes while it waits: else nobody would look at that before an answer."""

        def ask(question: str) -> str:
            try:
                self.prompting = True
                return prompt(question)
            finally:
                self.prompting = False

        return ask


@contextlib.contextmanager
def listening(requests: StopRequests) -> Iterator[None]:
    """Turn signals into requests: Ctrl-C once, Ctrl-C twice, SIGTERM, SIGHUP. Nothing is interrupted half-way but a prompt."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handle(number: int, frame: FrameType | None) -> None:
        name = signal.Signals(number).name
        if number == signal.SIGINT and requests.level == 0:
            requests.ask(1, "Ctrl-C")
        else:
            requests.ask(2, "Ctrl-C twice" if number == signal.SIGINT else name)
        if requests.prompting:
            requests.heed(1)

    numbers = [signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]
    before = [(number, signal.signal(number, handle)) for number in numbers]
    try:
        yield
    finally:
        for number, handler in before:
            signal.signal(number, handler)


class Interlocks:
    """Conditions that end a run at once; the first one to trip stays tripped."""

    def __init__(self, profile: Profile, limits: Limits) -> None:
        low, high = profile.sensor.temp_range_c
        margin = profile.safe.gyro_margin_c
        #: Gyro temperatures that are still tolerated, deg C; the chamber's own alarms get the same.
        self.gyro_range_c = (low - margin, high + margin)
        top = max(limits.max_rate_dps.value, -limits.min_rate_dps.value)
        self.over_rate_dps = profile.safe.over_rate_dps or 1.1 * top
        self._frozen_share = profile.safe.frozen_share
        self.tripped: str | None = None

    def check(
        self, table: TableReading, faults: tuple[str, ...], chamber: ChamberReading, gyro_temp_c: float
    ) -> None:
        """Look at everything; raise when something trips, or has tripped before.

        Raises
        ------
        InterlockError
        """
        if self.tripped is None:
            self.tripped = self._reason(table, faults, chamber, gyro_temp_c)
        if self.tripped is not None:
            raise InterlockError(_trip_text(table.t_s, self.tripped))

    def check_thermometer(self, t_s: float, chamber_moved_c: float, gyro_moved_c: float) -> None:
        """A soaked gyro went where the chamber went; raise when its thermometer has not seen it, or has tripped before.

        Raises
        ------
        InterlockError
        """
        share = self._frozen_share
        if abs(chamber_moved_c) >= _TELLING_C and gyro_moved_c < share * abs(chamber_moved_c):
            self.tripped = self.tripped or (
                f"the chamber went by {chamber_moved_c:.1f} °C and was soaked, and the gyro's thermometer moved by "
                f"{gyro_moved_c:.2f} °C: it is frozen, or its unit is wrong (safe.frozen_share = 0 for a gyro with an oven)"
            )
        if self.tripped is not None:
            raise InterlockError(_trip_text(t_s, self.tripped))

    def _reason(
        self, table: TableReading, faults: tuple[str, ...], chamber: ChamberReading, gyro_temp_c: float
    ) -> str | None:
        if faults:
            return f"the table reports {', '.join(faults)}"
        if abs(table.rate_dps) > self.over_rate_dps:
            return f"the table turns at {table.rate_dps:.4g} deg/s, above {self.over_rate_dps:.4g} deg/s"
        if chamber.alarms:
            return f"the chamber reports {', '.join(chamber.alarms)}"
        if not chamber.running:
            return "the chamber is not running"
        low, high = self.gyro_range_c
        if gyro_temp_c < low or gyro_temp_c > high:
            return f"the gyro is at {gyro_temp_c:.1f} °C, outside {low:g} to {high:g} °C"
        return None


def _trip_text(t_s: float, reason: str) -> str:
    return f"Interlock at {t_s:.1f} s: {reason}. The bench was made safe; find the cause, then --resume."


@contextlib.contextmanager
def kept_safe(bench: Bench, clock: Clock, profile: Profile, note: Note) -> Iterator[None]:
    """Make safe on every way out of the block.

    Raises
    ------
    StopNotVerifiedError
        The table's read-back does not confirm that it stands; whatever else went wrong is its context.
    """
    cause: BaseException | None = None
    try:
        yield
    except BaseException as error:
        cause = error
        raise
    finally:
        make_safe(bench, clock, profile, note, cause)


def make_safe(
    bench: Bench, clock: Clock, profile: Profile, note: Note, cause: BaseException | None = None
) -> None:
    """Stop the table and verify it, then chamber to the safe set point, then close all; each whatever the others do.

    `cause` is what went wrong before; it stands in the error when the table is not seen to stand.
    """
    standing, rate_dps = stop_table(bench.table, clock, profile)
    told_s = profile.safe.stop_deadline_s + braking_time_s(bench.table)
    chamber_error = _chamber_to_safe(bench, clock, profile)
    for device in (bench.gyro, bench.chamber, bench.table):
        _attempt(device.close)
    _, journal_error = _attempt(
        lambda: note(
            "make_safe",
            table_stopped=standing,
            table_rate_dps=rate_dps,
            chamber_setpoint_c=None if chamber_error else profile.safe.chamber_c,
            chamber_error=str(chamber_error) if chamber_error else None,
        )
    )
    if not standing:
        last = "nothing" if rate_dps is None else f"{rate_dps:.4g} deg/s"
        msg = (
            f"THE TABLE MAY STILL BE TURNING: it was told to stop for {told_s:.0f} s, and "
            f"its last read-back was {last}. Use its emergency stop now."
            + (f" What went wrong before: {cause}" if cause else "")
        )
        raise StopNotVerifiedError(msg)
    if journal_error:
        raise journal_error


def braking_time_s(table: RateTable) -> float:
    """Time in which the table can come to rest from its highest rate; 0 where it cannot be asked."""
    limits, _ = _attempt(table.limits)
    return limits.max_rate_dps / limits.max_acceleration_dps2 if limits else 0.0


def stop_table(table: RateTable, clock: Clock, profile: Profile) -> tuple[bool, float | None]:
    """Send stops until two readings in a row, of rate and of angle, show a table at rest; ``(standing, last rate)``.

    Never raises: a port that is gone is tried again until the deadline.
    """
    _attempt(table.send_stop)  # first of all; asking the table for its limits may take time
    deadline_s = clock.now_s() + profile.safe.stop_deadline_s + braking_time_s(table)
    before: TableReading | None = None
    last_dps: float | None = None
    while True:
        _attempt(table.send_stop)
        sent_s = clock.now_s()
        clock.sleep(_STOP_PERIOD_S)
        reading, _ = _attempt(table.read)
        if reading is not None and reading.t_s >= sent_s:
            last_dps = reading.rate_dps
            if not abs(reading.rate_dps) <= profile.safe.standing_dps:
                before = None
            elif before is not None and _stands(before, reading, profile.safe.standing_dps):
                return True, last_dps
            else:
                before = reading
        if clock.now_s() >= deadline_s:
            return False, last_dps


def _chamber_to_safe(bench: Bench, clock: Clock, profile: Profile) -> Exception | None:
    """Send the safe set point, again when it fails; the last error."""
    error: Exception | None = None
    for _ in range(_CHAMBER_TOLD):
        _, error = _attempt(lambda: bench.chamber.set_setpoint(profile.safe.chamber_c))
        if error is None:
            break
        clock.sleep(_STOP_PERIOD_S)
    return error


def _stands(before: TableReading, after: TableReading, standing_dps: float) -> bool:
    """Whether the angle confirms what the rate says; a table without an angle (NaN) cannot contradict."""
    moved_deg = abs(after.angle_deg - before.angle_deg)
    allowed_deg = standing_dps * (after.t_s - before.t_s) + _ENCODER_UNREST_DEG
    return not moved_deg > allowed_deg


def _attempt(action: Callable[[], T]) -> tuple[T | None, Exception | None]:
    """Result or error of one safe-making act: whatever one device raises, the next act must still be done."""
    try:
        return action(), None
    except Exception as error:  # noqa: BLE001
        return None, error
