"""gyrocal's own protocol for home-made tables: one JSON object a line each way, 115200 8N1, LF.

Requests, each with an ``"id"``               Answers, each with the ``"id"`` of its request
``{"command": "hello"}``                      ``{"ok": true, "name": ..., "max_rate_dps": ..., "max_acceleration_dps2": ...}``
``{"command": "set_rate", "rate_dps": 10}``   ``{"ok": true, "rate_dps": 9.99985}``: the rate that the motor can make
``{"command": "read"}``                       ``{"ok": true, "rate_dps": ..., "angle_deg": ..., "faults": []}``
``{"command": "stop"}``                       ``{"ok": true}``; must also be obeyed when nobody reads the answer

The id is a whole number that changes with every request: an answer without it, or with another, is not taken, so that a
late one never passes for the next. Counter-clockwise from above is positive; the angle is unwrapped. A refusal is ``{"ok": false, "error": "..."}``. The
table has to stop by itself when no line comes for ``watchdog_s`` seconds (``hello`` sets it): nobody else does when the
program or its computer dies.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

from gyrocal.bench.clock import Clock
from gyrocal.bench.conversation import Conversation, ended_by
from gyrocal.bench.devices import RateTable, TableLimits, TableReading
from gyrocal.bench.responder import LineResponder
from gyrocal.bench.schema import number
from gyrocal.bench.transport import Transport
from gyrocal.errors import DeviceError


@dataclass(frozen=True)
class Options:
    """Times of the link.

    Attributes
    ----------
    timeout_s : float
        Longest wait for an answer.
    watchdog_s : float
        The table stops by itself when no line has come for so long.
    """

    timeout_s: float = number(0.01, 60.0, "s", 1.0)
    watchdog_s: float = number(0.1, 3600.0, "s", 10.0)


class JsonLinesTable:
    """Driver of a home-made table; see `gyrocal.bench.devices.RateTable`. Rates deg/s, angles deg."""

    def __init__(self, transport: Transport, clock: Clock, options: Options = Options()) -> None:
        self._talk = Conversation(transport, "JSON-lines table", ended_by(b"\n"), options.timeout_s)
        self._clock = clock
        self._options = options
        self._limits: TableLimits | None = None
        self._id = 0

    def limits(self) -> TableLimits:
        """Limits that the table states in ``hello``."""
        if self._limits is None:
            self._limits = self._greet()
        return self._limits

    def start(self) -> None:
        """Greet the table, which arms its watchdog, also after it was switched off and on; does not move."""
        self._limits = self._greet()

    def set_rate(self, rate_dps: float) -> float:
        """Command a rate; returns the one that the table says it makes."""
        limit = self.limits().max_rate_dps
        if not abs(rate_dps) <= limit:
            msg = f"JSON-lines table: {rate_dps:g} deg/s is beyond the limit of {limit:g} deg/s; nothing was sent."
            raise DeviceError(msg)
        return _number(self._ask({"command": "set_rate", "rate_dps": rate_dps}), "rate_dps")

    def read(self) -> TableReading:
        """Measured rate and angle, at the middle of question and answer."""
        asked_s = self._clock.now_s()
        answer = self._ask({"command": "read"})
        rate_dps, angle_deg = _number(answer, "rate_dps"), _number(answer, "angle_deg")
        return TableReading.between(asked_s, self._clock.now_s(), rate_dps, angle_deg)

    def faults(self) -> tuple[str, ...]:
        """Faults in the table's own words."""
        return tuple(str(fault) for fault in self._ask({"command": "read"}).get("faults", []))

    def send_stop(self) -> None:
        """Send ``stop`` without waiting."""
        self._talk.send(self._request({"command": "stop"}))

    def close(self) -> None:
        """Close the port."""
        self._talk.transport.close()

    def _greet(self) -> TableLimits:
        answer = self._ask({"command": "hello", "watchdog_s": self._options.watchdog_s})
        return TableLimits(_number(answer, "max_rate_dps"), _number(answer, "max_acceleration_dps2"))

    def _request(self, request: dict[str, Any]) -> bytes:
        self._id += 1
        return _line(request | {"id": self._id})

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        answer = self._talk.ask(self._request(request), self._answer)
        if answer.get("ok") is not True:
            said = answer.get("error", "no reason")
            raise DeviceError(f"JSON-lines table: refused {request['command']} ({said}).")
        return answer

    def _answer(self, line: bytes) -> dict[str, Any] | None:
        """The answer to the last request; None for any other line, an echo of the request among them."""
        try:
            answer = json.loads(line)
        except (ValueError, RecursionError):
            return None
        if not isinstance(answer, dict) or "ok" not in answer or answer.get("id") != self._id:
            return None
        return answer


def _line(message: dict[str, Any]) -> bytes:
    return json.dumps(message).encode() + b"\n"


def _number(answer: dict[str, Any], key: str) -> float:
    value = answer.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise DeviceError(f"JSON-lines table: {key} is {value!r}, and a number is wanted.")
    return float(value)


class JsonLinesResponder(LineResponder):
    """The table's side, and the reference for those who build one."""

    terminator = b"\n"

    def __init__(self, table: RateTable, options: Options = Options()) -> None:
        super().__init__()
        self._table = table
        self._heard_s = 0.0
        self._watchdog_s = math.inf

    def feed(self, data: bytes) -> bytes:
        """Answers; without `data` the watchdog looks whether anybody is still there."""
        now_s = self._table.read().t_s
        if data:
            self._heard_s = now_s
        elif now_s - self._heard_s > self._watchdog_s:
            self._heard_s = now_s
            self._table.set_rate(0.0)
        return super().feed(data)

    def answer(self, line: str) -> bytes:
        """Answer of the table, with the id of its request."""
        try:
            request = json.loads(line)
            command = request["command"]
        except (ValueError, TypeError, KeyError, RecursionError):
            return _line({"ok": False, "error": "not a JSON object with a command"})
        return _line(self._perform(command, request) | {"id": request.get("id")})

    def _perform(self, command: str, request: dict[str, Any]) -> dict[str, Any]:
        if command == "hello":
            limits = self._table.limits()
            watchdog_s = request.get("watchdog_s")
            if isinstance(watchdog_s, int | float):
                self._watchdog_s = watchdog_s
            known = {
                "max_rate_dps": limits.max_rate_dps,
                "max_acceleration_dps2": limits.max_acceleration_dps2,
            }
            return {"ok": True, "name": "virtual table"} | known
        if command == "stop":
            self._table.set_rate(0.0)
            return {"ok": True}
        if command == "read":
            reading = self._table.read()
            faults = list(self._table.faults())
            return {
                "ok": True,
                "rate_dps": reading.rate_dps,
                "angle_deg": reading.angle_deg,
                "faults": faults,
            }
        rate = request.get("rate_dps")
        if (
            command == "set_rate"
            and isinstance(rate, int | float)
            and abs(rate) <= self._table.limits().max_rate_dps
        ):
            return {"ok": True, "rate_dps": self._table.set_rate(float(rate))}
        return {"ok": False, "error": f"cannot do {command} {rate}"}
