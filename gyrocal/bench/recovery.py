"""Devices started at the beginning of a run, and again when one was lost in the middle of it: within a limit, or it ends."""

from __future__ import annotations

from collections.abc import Callable

from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import Bench
from gyrocal.bench.looking import Lookout
from gyrocal.bench.plan import Step
from gyrocal.bench.profile import Profile
from gyrocal.bench.safety import Contact, Interlocks, stop_table, stop_time_s
from gyrocal.errors import DeviceError

#: Between two tries to reach the devices, s.
_TRY_PERIOD_S = 1.0


def start_devices(bench: Bench, interlocks: Interlocks, contact: Contact) -> None:
    """Start all devices, and set the chamber's own alarms; nothing moves. Raises DeviceError."""
    _start(bench.table.start)
    contact.chamber_started = True
    _start(bench.chamber.start)
    bench.gyro.start()
    bench.chamber.set_alarm_limits(*interlocks.gyro_range_c)


def _start(start: Callable[[], None]) -> None:
    try:
        start()
    except DeviceError:
        start()  # a program that died may have left half a command before the first one


def bring_back(
    bench: Bench,
    clock: Clock,
    profile: Profile,
    step: Step,
    lookout: Lookout,
    interlocks: Interlocks,
    error: DeviceError,
) -> None:
    """Start all devices again, with their modes and alarm limits, within ``retry.wait_s``; the table stands meanwhile.

    Raises
    ------
    DeviceError
        `error` when the table is not seen to stand; else the last one when a device does not come back.
    InterlockError, InterruptedRunError
        From the first look afterwards, and while waiting.
    """
    with lookout.requests.sheltered():
        stop = stop_table(bench.table, clock, profile, stop_time_s(bench.table, profile))
    if not stop.standing:
        raise error
    deadline_s = clock.now_s() + profile.retry.wait_s
    while True:
        try:
            _start_again(bench, step, interlocks)
            lookout.forget()
            lookout.look(_TRY_PERIOD_S)
            return
        except DeviceError:
            if clock.now_s() >= deadline_s:
                raise
        lookout.requests.heed(1)
        clock.sleep(_TRY_PERIOD_S)


def _start_again(bench: Bench, step: Step, interlocks: Interlocks) -> None:
    """Start every device as if it had lost its mode: which one did is not known. Nothing moves."""
    bench.table.start()
    bench.chamber.start()
    if step.kind != "ramp":
        bench.chamber.set_setpoint(step.chamber_c)
    bench.chamber.set_alarm_limits(*interlocks.gyro_range_c)
    bench.gyro.close()
    bench.gyro.start()
