"""Tables by another hand, as their manuals and users describe them (protocols.md, 2)."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import ClassVar

from tests.bench.strangers.lab import Lab, Line, Lines


class TableDevice:
    """A table on a line; `world` is the lab's table, counter-clockwise positive, in deg/s."""

    kind = ""
    options: ClassVar[Mapping[str, object]] = {}
    end = b"\r"
    #: How finely the wire says rate and angle, deg/s and deg.
    rate_lsb_dps, angle_lsb_deg = 1e-3, 1e-3

    def __init__(self, lab: Lab, *, tcp: bool = False) -> None:
        self.lab = lab
        self.world = lab.table
        self.line = Line(lab, tcp=tcp)
        self.line.receive = self.receive
        self._lines = Lines(self.end)

    def receive(self, data: bytes) -> None:
        for line in self._lines.feed(data):
            self.lab.advance()
            self.obey(line)

    def obey(self, line: str) -> None:
        """Do what a line says, and answer."""
        raise NotImplementedError

    def demand(self, rate_dps: float, text: str) -> None:
        """Turn at another rate from now on."""
        self.lab.command(text)
        self.world.demand_dps = rate_dps

    def stop(self, text: str) -> None:
        """Stop, unless the fault says otherwise."""
        self.lab.command(text)
        if not self.line.faults.ignores_stop:
            self.world.demand_dps = 0.0


class Zaber(TableDevice):
    """X-RSW60C: `/1 1 07 move vel 17476` -> `@01 1 07 OK BUSY -- 0`.

    `NI` is raised by each movement command (`stop` too) that comes while the axis moves and stays until one comes
    on an idle axis; `NC` while somebody turns the knob; `WR` until homed. The flag of highest rank is shown.
    """

    kind = "zaber"
    end = b"\n"
    options: ClassVar[Mapping[str, object]] = {"max_acceleration_dps2": 200.0}
    rate_lsb_dps, angle_lsb_deg = 1.0 / 1.6384 / 1066.667, 1.0 / 1066.667
    MICROSTEPS_PER_DEG = 384000 / 360.0

    def __init__(self, lab: Lab, *, tcp: bool = False, knows_velocity: bool = True) -> None:
        super().__init__(lab, tcp=tcp)
        self.knows_velocity = knows_velocity
        self.homed = True
        self.knob = False
        self.interrupted = False
        self.settings = {"maxspeed": "262144", "limit.max": "2147483647", "limit.min": "-2147483647"}
        self.unnumbered = 0

    def flag(self) -> str:
        """The warning flag that a reply shows."""
        raised = [("WR", not self.homed), ("NC", self.knob), ("NI", self.interrupted)]
        return next((name for name, is_raised in raised if is_raised), "--")

    def obey(self, line: str) -> None:
        match = re.fullmatch(r"/(.*?)(?::([0-9A-Fa-f]{2}))?", line)
        if match is None:
            return
        body, check = match[1], match[2]
        if check and (-sum(body.encode()) & 0xFF) != int(check, 16):
            return  # a device ignores what is damaged
        words = body.split()
        numbers: list[str] = []
        while words and words[0].isdigit() and len(numbers) < 3:
            numbers.append(words.pop(0))
        device, axis = ([int(n) for n in numbers[:2]] + [0, 0])[:2]
        number = f" {int(numbers[2]):02d}" if len(numbers) == 3 else ""
        if device not in (0, 1):
            return
        self.unnumbered += not number
        status, data = self._do(words)
        state = "BUSY" if self.world.moving else "IDLE"
        self.line.send(f"@01 {axis}{number} {status} {state} {self.flag()} {data}\r\n".encode())

    def _do(self, words: list[str]) -> tuple[str, str]:
        text = " ".join(words)
        if not words:
            return "OK", "0"
        if words[0] in ("move", "stop", "estop", "home"):
            return self._move(words, text)
        if words[:1] == ["get"] and len(words) == 2:
            return self._get(words[1])
        if words[:1] == ["set"] and len(words) == 3 and words[1] in (*self.settings, "accel"):
            self.settings[words[1]] = words[2]
            return "OK", "0"
        if words == ["warnings"] or words == ["warnings", "clear"]:
            found = [] if self.flag() == "--" else [self.flag()]
            if words[-1] == "clear":
                self.interrupted = self.knob = False
            return "OK", " ".join([f"{len(found):02d}", *found])
        return "RJ", "BADCOMMAND"

    def _move(self, words: list[str], text: str) -> tuple[str, str]:
        if words[0] in ("stop", "estop"):
            self.interrupted = self.world.moving
            self.stop(text)
            return "OK", "0"
        if words[:2] == ["move", "vel"] and len(words) == 3 and re.fullmatch(r"-?\d+", words[2]):
            if abs(int(words[2])) > int(self.settings["maxspeed"]):
                return "RJ", "BADDATA"
            self.interrupted = self.world.moving
            self.demand(int(words[2]) / 1.6384 / self.MICROSTEPS_PER_DEG, text)
            return "OK", "0"
        if words == ["home"]:
            self.homed = True
            return "OK", "0"
        return "RJ", "BADDATA"

    def _get(self, setting: str) -> tuple[str, str]:
        if setting == "pos":
            return "OK", str(round(self.world.angle_deg * self.MICROSTEPS_PER_DEG))
        if setting == "vel" and self.knows_velocity:
            return "OK", str(round(self.world.rate_dps * self.MICROSTEPS_PER_DEG * 1.6384))
        known = {
            "resolution": "64",
            "deviceid": "50081",
            "device.id": "50081",
            "version": "7.38",
        } | self.settings
        return ("OK", known[setting]) if setting in known else ("RJ", "BADCOMMAND")


class Aerosmith(TableDevice):
    """Ideal Aerosmith 1270VS: a value (or an empty line) and the prompt `>`; `JOG` answers only when the next command comes.

    Clockwise positive, rates in whole deg/s, position within 0 to 360.
    """

    kind = "aerosmith"
    options: ClassVar[Mapping[str, object]] = {"max_acceleration_dps2": 200.0}

    def __init__(self, lab: Lab, *, tcp: bool = False, echoes: bool = False) -> None:
        super().__init__(lab, tcp=tcp)
        self.echoes = echoes
        self.owes = False

    def obey(self, line: str) -> None:
        line = line.lstrip("\n")
        if not line:
            return
        word, number = line[:3].upper(), line[3:].strip()
        if self.owes:
            self.owes = False
            self.line.send(b"\r\n>")
        reply = self._do(word, number, line)
        if word == "JOG" and reply != "?":
            self.owes = True
            return
        said = f"{word} {reply}" if self.echoes and reply not in ("", "?") else reply
        self.line.send(f"{said}\r\n>".encode())

    def _do(self, word: str, number: str, line: str) -> str:
        if word == "JOG" and re.fullmatch(r"[+-]?\d+", number):
            self.demand(-float(number), line)
            return ""
        if word == "STO" and not number:
            self.stop(line)
            return ""
        if word == "PPO":
            return f"{-self.world.angle_deg % 360.0:.3f}"
        if word == "PVE":
            return f"{-self.world.rate_dps:.3f}"
        if word == "ACL" and re.fullmatch(r"\d+(\.\d+)?", number):
            self.world.acceleration_dps2 = float(number)
            return ""
        if word == "STA":
            return "0"
        return "" if word in ("VEL", "HOM", "SRV") else "?"


class Acutrol(TableDevice):
    """ACUTROL3000: every command is answered by 4 characters of error code, 4 of length, and data; CR LF.

    Motion needs lockout, an interlock without a latched fault that was closed, and the rate mode.
    """

    kind = "acutrol"
    end = b"\n"
    options: ClassVar[Mapping[str, object]] = {"max_acceleration_dps2": 200.0}
    rate_lsb_dps, angle_lsb_deg = 1e-4, 1e-4
    WORDS = (
        *(
            "mode",
            "rate",
            "off",
            "position",
            "demand",
            "read",
            "acceleration",
            "limit",
            "vtrip",
            "velocitytrip",
        ),
        *(
            "absolute",
            "utility",
            "lockout",
            "interlock",
            "open",
            "close",
            "reset",
            "status",
            "msg",
            "query",
            "error",
        ),
    )

    def __init__(self, lab: Lab, *, tcp: bool = False) -> None:
        super().__init__(lab, tcp=tcp)
        self.closed = self.remote = self.rate_mode = False
        self.latched = False
        self.limits: dict[str, str] = {}

    def obey(self, line: str) -> None:
        code, data, header = 0, [], ""
        for part in line.split(";"):
            path, _, arguments = part.strip().partition(" ")
            if not path.startswith((":", "*")):
                path = f"{header}:{path}"
            header = path.rpartition(":")[0]
            number, said = self._do(self._whole(path), [a.strip() for a in arguments.split(",")], part)
            code = code or number
            data.append(said)
        text = ";".join(data)
        self.line.send(f"{code:04d}{len(text):04d}{text}\r\n".encode())

    def _whole(self, path: str) -> str:
        """Abbreviated words written out."""
        asks = "?" if path.endswith("?") else ""
        words = path.rstrip("?").strip(":").lower().split(":")
        whole = [
            next((w for w in self.WORDS if len(word) >= 3 and w.startswith(word)), word) for word in words
        ]
        return ":".join(whole) + asks

    def _do(self, path: str, arguments: list[str], text: str) -> tuple[int, str]:
        if path.endswith("?"):
            return self._ask(path, arguments)
        if path == "utility:lockout":
            self.remote = arguments[0].upper() == "ON"
        elif path == "interlock:open":
            self.closed = self.rate_mode = False
            self.stop(text)
        elif path == "interlock:reset":
            self.latched = False
        elif path == "interlock:close":
            if self.latched:
                return 221, ""
            self.closed = True
        elif path == "mode:off":
            self.rate_mode = False
            self.stop(text)
        elif path == "mode:rate":
            if not (self.closed and self.remote):
                return 222, ""
            self.rate_mode = True
        elif path == "demand:rate":
            if not self.rate_mode or arguments[0] != "1":
                return 223, ""
            self.demand(float(arguments[1]), text) if float(arguments[1]) else self.stop(text)
        elif path.startswith("limit:"):
            if "acceleration" in path:
                self.world.acceleration_dps2 = float(arguments[-1])
            self.limits[f"{path}? {','.join(arguments[:-1]).upper()}"] = arguments[-1]
        else:
            return 113, ""
        return 0, "OK"

    def _ask(self, path: str, arguments: list[str]) -> tuple[int, str]:
        world = self.world
        values = {
            "read:position?": f"{world.angle_deg:.4f}",
            "read:rate?": f"{world.rate_dps:.4f}",
            "read:acceleration?": "0.0000",
            "interlock?": "Fault" if self.latched else "Closed" if self.closed else "Open",
            "*stb?": "0",
            "query:error?": "No error",
            "status:msg?": "0",
        }
        limit = self.limits.get(f"{path} {','.join(arguments).upper()}")
        if path.startswith("limit:"):
            return 0, limit if limit is not None else "1000.0"
        return (0, values[path]) if path in values else (113, "")


class JsonLines(TableDevice):
    """A home-made table that speaks gyrocal's own JSON lines, watchdog and all."""

    kind = "json-lines"
    end = b"\n"
    rate_lsb_dps, angle_lsb_deg = 1e-6, 1e-6

    def __init__(self, lab: Lab, *, tcp: bool = False) -> None:
        super().__init__(lab, tcp=tcp)
        self.watchdog_s = 10.0
        self._fed_s = lab.now()

    def obey(self, line: str) -> None:
        self._fed_s = self.lab.now()
        self.lab.after(self.watchdog_s, self._watch)
        number: dict[str, object] = {}
        try:
            request = json.loads(line)
            number = {"id": request["id"]}
            answer = self._do(request)
        except (ValueError, KeyError, TypeError) as error:
            answer = {"ok": False, "error": str(error)}
        answer |= number
        self.line.send(json.dumps(answer).encode() + b"\n")

    def _watch(self) -> None:
        if self.lab.now() - self._fed_s >= self.watchdog_s and self.world.demand_dps:
            self.stop("watchdog")

    def _do(self, request: dict[str, object]) -> dict[str, object]:
        command = request["command"]
        if command == "hello":
            self.watchdog_s = float(str(request.get("watchdog_s", self.watchdog_s)))
            return {"ok": True, "name": "bicycle", "max_rate_dps": 120.0, "max_acceleration_dps2": 200.0}
        if command == "set_rate":
            rate = round(float(str(request["rate_dps"])) / 0.005) * 0.005
            self.demand(rate, json.dumps(request))
            return {"ok": True, "rate_dps": rate}
        if command == "read":
            world = self.world
            return {"ok": True, "rate_dps": world.rate_dps, "angle_deg": world.angle_deg, "faults": []}
        if command == "stop":
            self.stop("stop")
            return {"ok": True}
        return {"ok": False, "error": f"unknown command {command}"}


TABLES: dict[str, type[TableDevice]] = {t.kind: t for t in (Zaber, Aerosmith, Acutrol, JsonLines)}
