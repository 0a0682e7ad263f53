"""Every way out leads through here: table stopped and seen to stand, chamber to its safe set point. And interlocks."""

from __future__ import annotations

import contextlib
import math
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import FrameType
from typing import Any, Protocol, TypeGuard, TypeVar

from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import Bench, ChamberReading, RateTable, TableReading
from gyrocal.bench.plan import Limits
from gyrocal.bench.profile import Profile
from gyrocal.errors import DeviceError, InterlockError, InterruptedRunError, StopNotVerifiedError

T = TypeVar("T")

#: Between two stop commands, s.
_STOP_PERIOD_S = 0.5
#: A table that stands does so over this time, in so many readings: the slowest turning that counts as one then shows
#: in the angle.
_STANDING_S, _STANDING_READINGS = 2.0, 3
#: A table that was given no rate is looked at for so long at most.
_GLANCE_S = 5.0
#: More than anybody can ask for.
_NEVER = 3
#: How often the chamber is told its safe set point at most.
_CHAMBER_TOLD = 3
#: An encoder's own unrest between two readings at rest, deg.
_ENCODER_UNREST_DEG = 1e-3
_TURN_DEG = 360.0
#: Below this share of the highest rate a gyro's bias may hide what it says.
_TELLING_SHARE = 0.05
#: A move of the chamber after which a soaked gyro's thermometer must have moved too, deg C.
_TELLING_C = 5.0


#: Signals that a run takes for requests: all that would end the program with the table turning. Not every system has all.
_ENDING = (
    "SIGINT",
    "SIGTERM",
    "SIGHUP",
    "SIGQUIT",
    "SIGABRT",
    "SIGALRM",
    "SIGUSR1",
    "SIGUSR2",
    "SIGXCPU",
    "SIGPWR",
)
#: And those that would suspend it (Ctrl-Z, a terminal that belongs to another job): a turning table cannot be left alone.
_SUSPENDING = ("SIGTSTP", "SIGTTIN", "SIGTTOU")


class Note(Protocol):
    """How the journal is told."""

    def __call__(self, event: str, **details: Any) -> None: ...


@dataclass
class StopRequests:
    """What the operator or the system asked for: 0 nothing, 1 end after the data set at hand, 2 end now.

    Attributes
    ----------
    prompting : bool
        The program waits for the operator's answer, and a request ends that wait.
    ends_at : int
        Level that ends what is being done now: 2 while a data set is recorded, which is worth its end.
    """

    level: int = 0
    reason: str = ""
    prompting: bool = False
    ends_at: int = 1

    def ask(self, level: int, reason: str) -> None:
        """Ask; a request is never taken back."""
        if level > self.level:
            self.level, self.reason = level, reason

    def heed(self, level: int) -> None:
        """Raise InterruptedRunError when at least this level was asked for."""
        if self.level >= level:
            msg = f"Ended by {self.reason}; what was sealed is kept, and --resume carries on."
            raise InterruptedRunError(msg)

    def attend(self) -> None:
        """Called by whoever waits for a device or a time, often; raises InterruptedRunError to end what is being done."""
        self.heed(self.ends_at)

    @contextlib.contextmanager
    def sheltered(self) -> Iterator[None]:
        """Let nothing end what is done within: making safe, which every request would lead to."""
        before, self.ends_at = self.ends_at, _NEVER
        try:
            yield
        finally:
            self.ends_at = before

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
    """Turn signals into requests: Ctrl-C once, Ctrl-C twice, and those that end a program; Ctrl-Z does nothing.

    Nothing is interrupted half-way but a prompt: whoever waits attends to the requests. A hang-up that the program
    was started to outlive (``nohup``) stays without effect.
    """
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

    found = {name: getattr(signal, name) for name in (*_ENDING, *_SUSPENDING) if hasattr(signal, name)}
    outlived = {number for name, number in found.items() if name == "SIGHUP" and _is_ignored(number)}
    before = {
        number: signal.signal(number, handle if name in _ENDING else signal.SIG_IGN)
        for name, number in found.items()
        if number not in outlived
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _is_ignored(number: int) -> bool:
    return signal.getsignal(number) == signal.SIG_IGN


class Interlocks:
    """Conditions that end a run at once; the first one to trip stays tripped."""

    def __init__(self, profile: Profile, limits: Limits) -> None:
        low, high = profile.sensor.temp_range_c
        margin = profile.safe.gyro_margin_c
        #: Temperatures of the gyro, or of the plate under it, that are still tolerated, deg C; the chamber's own alarms
        #: get the same.
        self.gyro_range_c = (low - margin, high + margin)
        #: And of the chamber's air: many gyros have no thermometer, and a chamber that runs away is seen there first.
        self.air_range_c = (limits.min_temp_c.value - margin, limits.max_temp_c.value + margin)
        top = max(limits.max_rate_dps.value, -limits.min_rate_dps.value)
        self.over_rate_dps = profile.safe.over_rate_dps or 1.1 * top
        self._frozen_share, self._follow_share = profile.safe.frozen_share, profile.safe.follow_share
        self._telling_dps = _TELLING_SHARE * top
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

    def check_gyro_follows(self, t_s: float, table_dps: float, gyro_dps: float) -> None:
        """A data set is over; raise when the gyro did not say what the table did, or something has tripped before.

        Raises
        ------
        InterlockError
        """
        share = self._follow_share
        off_dps = abs(gyro_dps - table_dps)
        if share and abs(table_dps) >= self._telling_dps and not off_dps <= share * abs(table_dps):
            self.tripped = self.tripped or (
                f"the table turned at {table_dps:.4g} deg/s and the gyro said {gyro_dps:.4g}: its mode (increments in the "
                "place of rates?), its sign, scale or axis is wrong (safe.follow_share = 0 for a gyro that need not follow)"
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
        for what, temp_c, (low, high) in (
            ("the gyro", gyro_temp_c, self.gyro_range_c),
            ("the plate under the gyro", chamber.plate_c, self.gyro_range_c),
            ("the chamber's air", chamber.temp_c, self.air_range_c),
        ):
            if temp_c < low or temp_c > high:
                return f"{what} is at {temp_c:.1f} °C, outside {low:g} to {high:g} °C"
        if math.isnan(gyro_temp_c) and math.isnan(chamber.temp_c):
            return "neither gyro nor chamber says how warm it is"
        return None


def _trip_text(t_s: float, reason: str) -> str:
    return f"Interlock at {t_s:.1f} s: {reason}. Find the cause, then --resume."


@dataclass
class Contact:
    """What this start has done to the bench: making safe undoes that and no more."""

    table_moved: bool = False
    chamber_started: bool = False


@contextlib.contextmanager
def kept_safe(
    bench: Bench, clock: Clock, profile: Profile, note: Note, requests: StopRequests, contact: Contact
) -> Iterator[None]:
    """Make safe on every way out of the block; what ends it has a note of what came of that.

    Raises
    ------
    StopNotVerifiedError
        The table's read-back does not confirm that it stands; whatever else went wrong is its context.
    DeviceError
        Nothing went wrong but that the chamber did not take its safe set point.
    """
    cause: BaseException | None = None
    try:
        yield
    except BaseException as error:
        cause = error
        raise
    finally:
        with requests.sheltered():
            make_safe(bench, clock, profile, note, contact, cause)


def make_safe(
    bench: Bench,
    clock: Clock,
    profile: Profile,
    note: Note,
    contact: Contact,
    cause: BaseException | None = None,
) -> None:
    """Stop the table and verify it, then chamber to the safe set point, then close all; each whatever the others do.

    `cause` is what went wrong before; it stands in the error when the table is not seen to stand. A table that was
    given no rate and says nothing is no emergency; one that is seen to turn is, whoever set it going.
    """
    within_s = stop_time_s(bench.table, profile) if contact.table_moved else _GLANCE_S
    stop = stop_table(bench.table, clock, profile, within_s)
    chamber_error = _chamber_to_safe(bench, clock, profile) if contact.chamber_started else None
    for device in (bench.gyro, bench.chamber, bench.table):
        _attempt(device.close)
    told_c = profile.safe.chamber_c if contact.chamber_started and chamber_error is None else None
    line = {
        "table_moved": contact.table_moved,
        "table_stopped": stop.standing,
        "table_rate_dps": stop.rate_dps,
        "chamber_setpoint_c": told_c,
        "chamber_error": str(chamber_error) if chamber_error else None,
    }
    _, journal_error = _attempt(lambda: note("make_safe", **line))
    turning = _may_turn(line)
    ended: Exception | None = journal_error
    if turning:
        ended = StopNotVerifiedError(
            f"THE TABLE MAY STILL BE TURNING: {stop.told(within_s)}. Use its emergency stop now."
            + (f" What went wrong before: {cause}" if cause else "")
        )
    elif chamber_error and not cause:
        ended = ended or DeviceError("The plan is done, and the chamber was lost at its end.")
    last = ended or cause
    if last:
        last.add_note(chamber_text(line) if turning else made_safe_text(line))
    if ended:
        raise ended


def made_safe_text(line: Mapping[str, Any]) -> str:
    """What is known of table and chamber after they were made safe, by the journal's line ``make_safe``."""
    if _may_turn(line):
        table = "THE TABLE MAY STILL BE TURNING."
    elif line.get("table_stopped"):
        table = "The table stands."
    else:
        table = "The table was given no rate and does not say whether it stands."
    return f"{table} {chamber_text(line)}"


def chamber_text(line: Mapping[str, Any]) -> str:
    """What is known of the chamber, by the journal's line ``make_safe``; loud where it may be hot or cold for ever."""
    error, told_c = line.get("chamber_error"), line.get("chamber_setpoint_c")
    if error:
        return (
            f"THE CHAMBER MAY NOT BE SAFE: it did not take its safe set point ({str(error).removesuffix('.')}). "
            "Set it by hand now."
        )
    return f"The chamber is set to {told_c:g} °C." if _is_known(told_c) else "The chamber was left as it was."


def _may_turn(line: Mapping[str, Any]) -> bool:
    """Whether a table that is not seen to stand is an emergency: it was given a rate, or says one."""
    return not line.get("table_stopped") and (
        bool(line.get("table_moved")) or _is_known(line.get("table_rate_dps"))
    )


def _is_known(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not math.isnan(value)


def stop_time_s(table: RateTable, profile: Profile) -> float:
    """Time in which the table can come to rest from its highest rate and be seen to stand."""
    _attempt(table.send_stop)  # first of all: asking the table for its limits may take time
    limits, _ = _attempt(table.limits)
    braking_s = limits.max_rate_dps / limits.max_acceleration_dps2 if limits else 0.0
    return profile.safe.stop_deadline_s + braking_s


@dataclass
class Stop:
    """What came of stopping the table: whether it is seen to stand, its last rate, and why no stop was ever sent."""

    standing: bool = False
    rate_dps: float | None = None
    unsent: Exception | None = None

    def told(self, within_s: float) -> str:
        """What it was told and what it said, where it is not seen to stand."""
        if self.unsent is not None:
            reason = str(self.unsent).removesuffix(".")
            return f"for {within_s:.0f} s no stop could be sent to it ({reason})"
        last = f"{self.rate_dps:.4g} deg/s" if _is_known(self.rate_dps) else "nothing"
        return f"it was told to stop for {within_s:.0f} s, and its last read-back was {last}"


def stop_table(table: RateTable, clock: Clock, profile: Profile, within_s: float) -> Stop:
    """Send stops until rate and angle both show a table at rest for a while.

    The two are independent: a late answer cannot pass for either, and a turning that one of them hides moves the
    other. Never raises: a port that is gone is tried again until the deadline.
    """
    deadline_s = clock.now_s() + within_s
    seen: list[TableReading] = []
    stop, sent = Stop(), False
    while True:
        _, error = _attempt(table.send_stop)
        sent = sent or error is None
        stop.unsent = None if sent else error
        sent_s = clock.now_s()
        clock.sleep(_STOP_PERIOD_S)
        reading, _ = _attempt(table.read)
        if reading is not None and reading.t_s >= sent_s:
            stop.rate_dps = reading.rate_dps
            seen.append(reading)
            while not _together_at_rest(seen, profile.safe.standing_dps):
                del seen[0]
            if len(seen) >= _STANDING_READINGS and seen[-1].t_s - seen[0].t_s >= _STANDING_S:
                stop.standing = True
                return stop
        if clock.now_s() >= deadline_s:
            return stop


def _together_at_rest(seen: list[TableReading], standing_dps: float) -> bool:
    """Whether readings show no rate, and angles that stayed where they were; no reading is at rest too."""
    if not seen:
        return True
    if not all(math.isfinite(reading.angle_deg) for reading in seen):
        return False
    # From the first one and the shorter way: many a table counts from 0 to 360, and stands at 0.
    moved_deg = [math.remainder(reading.angle_deg - seen[0].angle_deg, _TURN_DEG) for reading in seen]
    allowed_deg = standing_dps * (seen[-1].t_s - seen[0].t_s) + _ENCODER_UNREST_DEG
    slow = all(abs(reading.rate_dps) <= standing_dps for reading in seen)
    return slow and max(moved_deg) - min(moved_deg) <= allowed_deg


def _chamber_to_safe(bench: Bench, clock: Clock, profile: Profile) -> Exception | None:
    """Send the safe set point, again when it fails; the last error."""
    error: Exception | None = None
    for _ in range(_CHAMBER_TOLD):
        _, error = _attempt(lambda: bench.chamber.set_setpoint(profile.safe.chamber_c))
        if error is None:
            break
        clock.sleep(_STOP_PERIOD_S)
    return error


def _attempt(action: Callable[[], T]) -> tuple[T | None, Exception | None]:
    """Result or error of one safe-making act: whatever one device raises, the next act must still be done."""
    try:
        return action(), None
    except Exception as error:  # noqa: BLE001
        return None, error
