"""Test doubles on the wire: a scripted port that fails on left-over bytes, and a port wired to a responder."""

from __future__ import annotations

from typing import Protocol

from gyrocal.bench.devices import ChamberLimits, ChamberReading, TableLimits, TableReading


class Responder(Protocol):
    """A device's side of the wire."""

    def feed(self, data: bytes) -> bytes: ...


class ScriptedTransport:
    """Expects each request in turn and gives its answer; `finish` fails on anything unsent or unread."""

    def __init__(self, *script: tuple[bytes, bytes]) -> None:
        self._script = list(script)
        self._waiting = b""
        self._waited_s = 0.0
        self.closed = False

    def now_s(self) -> float:
        return self._waited_s

    def write(self, data: bytes) -> None:
        assert self._script, f"nothing more was expected, and {data!r} was sent"
        expected, answer = self._script.pop(0)
        assert data == expected
        self._waiting += answer

    def read_available(self, wait_s: float) -> bytes:
        assert wait_s > 0.0 or not self._waiting, f"{self._waiting!r} was left unread"
        # One byte a time, as a slow line gives them. Time passes only while nothing comes.
        self._waited_s += 0.0 if self._waiting else wait_s
        byte, self._waiting = self._waiting[:1], self._waiting[1:]
        return byte

    def close(self) -> None:
        self.closed = True

    def finish(self) -> None:
        assert not self._script, f"{self._script[0][0]!r} was never sent"
        assert not self._waiting, f"{self._waiting!r} was left unread"


class LoopTransport:
    """A port with a responder at its other end; `sent` keeps what the driver wrote."""

    def __init__(self, responder: Responder) -> None:
        self._responder = responder
        self._waiting = b""
        self._waited_s = 0.0
        self.sent: list[bytes] = []

    def now_s(self) -> float:
        return self._waited_s

    def write(self, data: bytes) -> None:
        self.sent.append(data)
        self._waiting += self._responder.feed(data)

    def read_available(self, wait_s: float) -> bytes:
        self._waited_s += 0.0 if self._waiting else wait_s
        data, self._waiting = self._waiting, b""
        return data

    def close(self) -> None:
        self._waiting = b""


class IdealTable:
    """A table that is at its rate at once."""

    def __init__(self) -> None:
        self.rate_dps = 0.0
        self.angle_deg = 12.5
        self.fault: tuple[str, ...] = ()

    def limits(self) -> TableLimits:
        return TableLimits(150.0, 100.0)

    def start(self) -> None:
        pass

    def set_rate(self, rate_dps: float) -> float:
        self.rate_dps = rate_dps
        return rate_dps

    def read(self) -> TableReading:
        return TableReading(0.0, self.rate_dps, self.angle_deg)

    def faults(self) -> tuple[str, ...]:
        return self.fault

    def send_stop(self) -> None:
        self.rate_dps = 0.0

    def close(self) -> None:
        pass


class IdealChamber:
    """A chamber that is at its set point at once."""

    def __init__(self) -> None:
        self.setpoint_c = 23.4
        self.running = False
        self.alarms: tuple[str, ...] = ()
        self.alarm_limits: tuple[float, float] | None = None

    def limits(self) -> ChamberLimits:
        return ChamberLimits(-40.0, 85.0, 2.0)

    def start(self) -> None:
        self.running = True

    def set_alarm_limits(self, low_c: float, high_c: float) -> None:
        self.alarm_limits = (low_c, high_c)

    def set_setpoint(self, temp_c: float, ramp_c_per_min: float | None = None) -> None:
        self.setpoint_c = temp_c

    def read(self) -> ChamberReading:
        return ChamberReading(0.0, self.setpoint_c, self.setpoint_c, self.running, self.alarms)

    def close(self) -> None:
        pass
