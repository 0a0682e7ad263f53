"""Gyros by another hand: they stream what the table does to them, in the bytes of their manuals (protocols.md, 1)."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import ClassVar

from tests.bench.strangers.lab import Emission, Lab, Line, Lines

SCALE, BIAS_DPS, NOISE_DPS = 1.002, 0.03, 0.02


class Gyro:
    """A gyro at 100 Hz (or what it is told), mounted level: it feels the table, and noise."""

    kind = ""
    baud = 115200
    options: ClassVar[Mapping[str, object]] = {}
    #: The rate that a driver may write is as fine as this, deg/s.
    lsb_dps = 1e-6
    has_temperature = True

    def __init__(self, lab: Lab, *, tcp: bool = False, rate_hz: float = 100.0) -> None:
        self.lab = lab
        self.line = Line(lab, tcp=tcp)
        self.line.receive = self.receive
        self.rate_hz = rate_hz
        self.bad = False
        self._count = 0
        self._next_s = lab.now()
        lab.after(0.0, self._sample)

    def receive(self, data: bytes) -> None:
        """Output only, until a subclass listens."""

    def frame(self, rate_dps: float, temp_c: float) -> tuple[bytes, float, float]:
        """Bytes of a sample, and rate (deg/s, counter-clockwise) and temperature as those bytes say them."""
        raise NotImplementedError

    def _sample(self) -> None:
        self.lab.advance()
        noise = self.lab.random.gauss(0.0, NOISE_DPS)
        rate = SCALE * self.lab.table.rate_dps + BIAS_DPS + noise
        data, said_dps, said_c = self.frame(rate, self.lab.chamber.gyro_c)
        # When it was due: this loop may be held up by a busy machine, and a driver knows that samples come evenly.
        self.lab.emissions.append(Emission(self._next_s, said_dps, said_c))
        self.line.put(data)
        self._count += 1
        self._next_s += 1.0 / self.rate_hz
        self.lab.at(self._next_s, self._sample)


class Dsp3000(Gyro):
    """KVH DSP-3000, 100 lines a second; `R`, `A`, `P`, `Z` choose the mode and are not acknowledged. Clockwise positive."""

    kind = "kvh-dsp3000"
    baud = 38400
    has_temperature = False

    def __init__(self, lab: Lab, *, tcp: bool = False, rate_hz: float = 100.0) -> None:
        self.mode = "R"
        self._angle_deg = 0.0
        super().__init__(lab, tcp=tcp, rate_hz=rate_hz)

    def receive(self, data: bytes) -> None:
        for letter in data.decode("latin-1"):
            if letter in "RAP":
                self.mode = letter
            elif letter == "Z":
                self._angle_deg = 0.0

    def frame(self, rate_dps: float, temp_c: float) -> tuple[bytes, float, float]:
        clockwise = -rate_dps
        self._angle_deg = (self._angle_deg + clockwise / self.rate_hz) % 360.0
        word = {"R": clockwise, "A": clockwise / self.rate_hz, "P": self._angle_deg}[self.mode]
        line = f"{word:15.6f}   {0 if self.bad else 1}\r\n".encode()
        return line, -round(word, 6), math.nan


class ECore2000(Gyro):
    """KVH E-Core 2000: eight bytes of seven bits, the first marked by bit 7; 60 deg/s unit, temperature in m1."""

    kind = "kvh-ecore2000"
    baud = 9600
    lsb_dps = 0.00183
    options: ClassVar[Mapping[str, object]] = {
        "lsb_dps": 0.00183,
        "temperature_byte": 1,
        "temperature_lsb_c": 0.5,
        "temperature_zero_c": -40.0,
    }

    def frame(self, rate_dps: float, temp_c: float) -> tuple[bytes, float, float]:
        counts = round(rate_dps / self.lsb_dps)
        temperature = max(0, min(255, round((temp_c + 40.0) / 0.5)))
        m = bytes([temperature, 0, 0, 0]) + struct.pack(">h", counts)
        whole = bytes([-sum(m) % 256]) + m
        bits = int.from_bytes(whole, "big")
        groups = [(bits >> (7 * k)) & 0x7F for k in range(7, -1, -1)]
        groups[0] |= 0x80
        return bytes(groups), counts * self.lsb_dps, 0.5 * temperature - 40.0


class FrameA(Gyro):
    """KVH 1750 IMU, format A: 36 bytes, delta angles in radians, hundredths of a degree, CRC-32/MPEG-2."""

    kind = "kvh-frame-a"
    baud = 921600
    head = b"\xfe\x81\xff\x55"
    options: ClassVar[Mapping[str, object]] = {"axis": "z"}

    def frame(self, rate_dps: float, temp_c: float) -> tuple[bytes, float, float]:
        turn = struct.unpack(">f", struct.pack(">f", math.radians(rate_dps / self.rate_hz)))[0]
        motion = struct.pack(">6f", 1e-5, -2e-5, turn, 0.01, 0.02, 1.0)
        stamp = self.stamp()
        status = 0x70 if self.bad else 0x77
        hundredths = round(100.0 * temp_c)
        body = self.head + motion + stamp + bytes([status, self._count % 128]) + struct.pack(">h", hundredths)
        return (
            body + struct.pack(">I", crc32_mpeg2(body)),
            math.degrees(turn) * self.rate_hz,
            0.01 * hundredths,
        )

    def stamp(self) -> bytes:
        """What stands before the status."""
        return b""


class FrameB(FrameA):
    """The same with a time stamp in microseconds: 40 bytes."""

    kind = "kvh-frame-b"
    head = b"\xfe\x81\xff\x56"

    def stamp(self) -> bytes:
        return struct.pack(">I", int(1e6 * self.lab.now()) % 2**32)


class Vn100(Gyro):
    """VectorNav VN-100: `$VNIMU` lines in rad/s with an 8-bit XOR; registers are echoed when written."""

    kind = "vn100"
    options: ClassVar[Mapping[str, object]] = {"axis": "z"}
    lsb_dps = math.degrees(1e-6)

    def __init__(self, lab: Lab, *, tcp: bool = False, rate_hz: float = 100.0) -> None:
        self._lines = Lines(b"\n")
        super().__init__(lab, tcp=tcp, rate_hz=rate_hz)

    def receive(self, data: bytes) -> None:
        for line in self._lines.feed(data):
            text = line.removeprefix("$").split("*")[0]
            if text.startswith("VNWRG,"):
                self.line.send(self._framed(text))
            elif text == "VNRRG,1" or text == "VNRRG,01":
                self.line.send(self._framed("VNRRG,01,VN-100"))
            elif text:
                self.line.send(self._framed("VNERR,04"))

    def frame(self, rate_dps: float, temp_c: float) -> tuple[bytes, float, float]:
        rate = round(math.radians(rate_dps), 6)
        fields = "-00.0350,+00.4222,-00.6643,-00.015,+00.019,+09.948,+00.002066,-00.008442"
        text = f"VNIMU,{fields},{rate:+010.6f},{temp_c:+05.1f},+084.322"
        return self._framed(text), math.degrees(rate), round(temp_c, 1)

    @staticmethod
    def _framed(text: str) -> bytes:
        check = 0
        for letter in text.encode():
            check ^= letter
        return f"${text}*{check:02X}\r\n".encode()


class AsciiLine(Gyro):
    """A home-made gyro: `rate in mdeg/s, temperature, status, counter`, clockwise never."""

    kind = "ascii-line"
    lsb_dps = 1e-6
    options: ClassVar[Mapping[str, object]] = {
        "columns": ["rate", "temp", "status", "sequence"],
        "rate_unit": "mdeg/s",
        "sequence_modulus": 256,
    }

    def frame(self, rate_dps: float, temp_c: float) -> tuple[bytes, float, float]:
        line = f"{1000.0 * rate_dps:.3f},{temp_c:.3f},{int(self.bad)},{self._count % 256}\r\n"
        return line.encode(), round(1000.0 * rate_dps, 3) / 1000.0, round(temp_c, 3)


def crc32_mpeg2(data: bytes) -> int:
    """CRC-32/MPEG-2, bit by bit as its definition says."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte << 24
        for _ in range(8):
            crc = ((crc << 1) ^ 0x04C11DB7 if crc & 0x80000000 else crc << 1) & 0xFFFFFFFF
    return crc


GYROS: dict[str, type[Gyro]] = {g.kind: g for g in (Dsp3000, ECore2000, FrameA, FrameB, Vn100, AsciiLine)}
