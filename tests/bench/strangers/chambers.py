"""Chambers with ASCII protocols by another hand (protocols.md, 3): ESPEC, Weiss ASCII-2, Watlow F4T by SCPI."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import ClassVar

from tests.bench.strangers.lab import Lab, Line, Lines

#: What every chamber here can do, deg C.
LOWEST_C, HIGHEST_C = -40.0, 120.0


class ChamberDevice:
    """A chamber on a line; `world` is the lab's air and gyro temperature."""

    kind = ""
    options: ClassVar[Mapping[str, object]] = {"max_ramp_c_per_min": 30.0}
    end = b"\n"
    #: How finely the wire says a temperature, deg C.
    lsb_c = 0.1
    #: Whether its own alarms can be set over the line.
    takes_alarms = False

    def __init__(self, lab: Lab, *, tcp: bool = True) -> None:
        self.lab = lab
        self.world = lab.chamber
        self.alarm = 0
        self._lines = Lines(self.end)
        self.open(tcp)

    def open(self, tcp: bool) -> None:
        """Have a line to answer on."""
        self.line = Line(self.lab, tcp=tcp)
        self.line.receive = self.receive
        self.url = self.line.url

    def receive(self, data: bytes) -> None:
        for line in self._lines.feed(data):
            self.lab.advance()
            answer = self.obey(line)
            if answer is not None:
                self.line.send(answer)

    def obey(self, line: str) -> bytes | None:
        """Do what a line says; the answer, None for silence."""
        raise NotImplementedError

    def set_point(self, temp_c: float, text: str) -> bool:
        """Take a set point; False where it is out of range."""
        if not LOWEST_C <= temp_c <= HIGHEST_C:
            return False
        self.lab.command(text)
        self.world.setpoint_c = temp_c
        return True


class Espec(ChamberDevice):
    """ESPEC SCP-220: queries end in `?`; what sets is answered `OK:` and its echo, what is refused `NA:` and why."""

    kind = "espec"
    end = b"\r\n"
    takes_alarms = True

    def __init__(self, lab: Lab, *, tcp: bool = True) -> None:
        super().__init__(lab, tcp=tcp)
        self.mode = "STANDBY"
        self.high_c, self.low_c = HIGHEST_C + 10.0, LOWEST_C - 10.0

    def obey(self, line: str) -> bytes | None:
        text = line.strip()
        return f"{self._do(text)}\r\n".encode()

    def _do(self, text: str) -> str:
        world = self.world
        answers = {
            "TYPE?": f"T,T,S2,{HIGHEST_C:.1f}",
            "ROM?": "P2SA 6.23",
            "TEMP?": f"{world.air_c:.1f},{world.setpoint_c:.1f},{self.high_c:.1f},{self.low_c:.1f}",
            "MON?": f"{world.air_c:.1f},,{self.mode},{int(self.alarm > 0)}",
            "MODE?": self.mode,
            "ALARM?": f"1,{self.alarm}" if self.alarm else "0",
        }
        if text.endswith("?"):
            return answers.get(text.upper(), "NA:CMD ERR")
        if match := re.fullmatch(r"TEMP,((?: ?[SHL]-?\d+\.\d)+)", text.upper()):
            return self._temperature(text, dict(re.findall(r"([SHL])(-?\d+\.\d)", match[1])))
        if match := re.fullmatch(r"MODE,\s?(OFF|STANDBY|CONSTANT)", text.upper()):
            self.mode = match[1]
            world.running = self.mode == "CONSTANT"
            self.lab.command(text)
            return f"OK:{text}"
        if match := re.fullmatch(r"POWER,\s?(ON|OFF)", text.upper()):
            self.mode = "CONSTANT" if match[1] == "ON" else "OFF"
            world.running = match[1] == "ON"
            return f"OK:{text}"
        return "NA:CMD ERR"

    def _temperature(self, text: str, values: dict[str, str]) -> str:
        if "S" in values and not self.set_point(float(values["S"]), text):
            return "NA:DATA OUT OF RANGE"
        self.high_c = float(values.get("H", self.high_c))
        self.low_c = float(values.get("L", self.low_c))
        return f"OK:{text}"


class Weiss(ChamberDevice):
    """Weiss ASCII-2: `$01I` tells nominal and actual of two control variables and 32 digits, `$01E ..` sets them all."""

    kind = "weiss"
    end = b"\r"

    def __init__(self, lab: Lab, *, tcp: bool = True) -> None:
        super().__init__(lab, tcp=tcp)
        self.digits = "0" * 32
        self.humidity_nominal = 40.0

    def obey(self, line: str) -> bytes | None:
        if line.startswith("$01I"):
            world = self.world
            fields = (world.setpoint_c, world.air_c, self.humidity_nominal, 41.5)
            return (" ".join([*(f"{v:06.1f}" for v in fields), self.digits]) + "\r").encode()
        if line.startswith("$01?"):
            return b"CV01 temperature C -040.0 0120.0\rCV02 humidity % 0010.0 0098.0\rDO01 start\r"
        if line.startswith("$01E"):
            self._set(line[4:].split(), line)
        return None

    def _set(self, fields: list[str], text: str) -> None:
        if len(fields) != 3 or not re.fullmatch("[01]{32}", fields[2]):
            return
        if self.set_point(float(fields[0]), text):
            self.humidity_nominal = float(fields[1])
            self.digits = fields[2]
            self.world.running = fields[2][1] == "1"


class F4tScpi(ChamberDevice):
    """Watlow F4T by SCPI: LF, what sets is not answered."""

    kind = "watlow-f4t-scpi"
    end = b"\n"
    lsb_c = 0.01

    def __init__(self, lab: Lab, *, tcp: bool = True) -> None:
        super().__init__(lab, tcp=tcp)
        self.unit = "F"

    def obey(self, line: str) -> bytes | None:
        word, _, value = line.upper().partition(" ")
        world = self.world
        answers = {
            "*IDN?": "WATLOW ELECTRIC,F4T,123456,5.2",
            ":SOURCE:CLOOP1:PVALUE?": self._say(world.air_c),
            ":SOURCE:CLOOP1:SPOINT?": self._say(world.setpoint_c),
            ":SOURCE:CLOOP1:ERROR?": "ERROR" if self.alarm else "NONE",
            ":OUTPUT1:STATE?": "ON" if world.running else "OFF",
            ":UNIT:TEMPERATURE?": self.unit,
            ":UNITS:TEMPERATURE?": self.unit,
        }
        if word in answers:
            return f"{answers[word]}\n".encode()
        if word == ":SOURCE:CLOOP1:SPOINT":
            number = float(value)
            self.set_point(number if self.unit == "C" else (number - 32.0) / 1.8, line)
        elif word == ":OUTPUT1:STATE":
            world.running = value == "ON"
        elif word in (":UNIT:TEMPERATURE", ":UNITS:TEMPERATURE"):
            self.unit = value
        return None

    def _say(self, temp_c: float) -> str:
        return f"{temp_c if self.unit == 'C' else 1.8 * temp_c + 32.0:.2f}"


ASCII_CHAMBERS: dict[str, type[ChamberDevice]] = {c.kind: c for c in (Espec, Weiss, F4tScpi)}
