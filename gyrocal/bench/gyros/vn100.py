"""VectorNav VN-100, ``$VNIMU`` ASCII messages at 115200 8N1 (protocols.md 1.7): uncompensated rates in rad/s.

The check field is the XOR of all characters between ``$`` and ``*`` in two hexadecimal digits, or a CRC-16 in four.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import reduce

from gyrocal.bench.gyros.codec import Frame, LineDecoder
from gyrocal.bench.schema import choice
from gyrocal.units import RAD_TO_DEG

_AXES = {"x": 6, "y": 7, "z": 8}
_TEMPERATURE = 9
_MESSAGE = re.compile(rb"\$(VNIMU,([^*$]*))\*([0-9A-Fa-f]{4}|[0-9A-Fa-f]{2})")
#: Three magnetic, three acceleration, three rate fields, temperature, pressure. The widths are fixed, and holding
#: them catches what the XOR cannot: two equal characters lost together.
_CONTENT = re.compile(
    rb"([+-]\d{2}\.\d{4},){3}([+-]\d{2}\.\d{3},){3}([+-]\d{2}\.\d{6},){3}[+-]\d{2}\.\d,[+-]\d{3}\.\d{3}"
)


#: Any asynchronous message: after power-up it is usually ``VNYMR``.
_ANY_MESSAGE = re.compile(rb"\$(VN(?!ERR|WRG|RRG)[A-Z]{3}),[^$*\r\n]*\*[0-9A-Fa-f]{2,4}\r\n")


def xor8(data: bytes) -> int:
    """XOR of all bytes."""
    return reduce(lambda a, b: a ^ b, data, 0)


def crc16(data: bytes) -> int:
    """CRC-16/XMODEM (CCITT, start 0), as VectorNav uses it."""
    crc = 0
    for byte in data:
        crc = (crc >> 8 | crc << 8 & 0xFF00) ^ byte
        crc ^= (crc & 0xFF) >> 4
        crc ^= crc << 12 & 0xFFFF
        crc ^= (crc & 0xFF) << 5 & 0xFFFF
    return crc


@dataclass(frozen=True)
class Options:
    """Axis on the table and its sign as mounted."""

    axis: str = choice(*_AXES, default="z")
    counter_clockwise_positive: bool = True


class Vn100Decoder(LineDecoder):
    """Bytes of a VN-100 to frames; lines other than VNIMU (register answers) are stepped over as damaged."""

    max_line = 256

    def __init__(self, options: Options = Options()) -> None:
        super().__init__()
        self._index = _AXES[options.axis]
        self._scale = RAD_TO_DEG if options.counter_clockwise_positive else -RAD_TO_DEG

    def _parse(self, line: bytes) -> Frame | None:
        match = _MESSAGE.fullmatch(line)
        if match is None:
            return None
        body, content, check = match[1], match[2], match[3]
        if int(check, 16) != (xor8(body) if len(check) == 2 else crc16(body)):
            return None
        if _CONTENT.fullmatch(content) is None:
            return None
        cells = content.split(b",")
        return Frame(float(cells[self._index]) * self._scale, float(cells[_TEMPERATURE]), raw=line)


def encode(rate_dps: float, temp_c: float, options: Options = Options()) -> bytes:
    """``$VNIMU`` line of a rate on the configured axis and a temperature.

    Raises
    ------
    ValueError
        A value is not finite.
    """
    if not (math.isfinite(rate_dps) and math.isfinite(temp_c)):
        raise ValueError("a VNIMU message carries finite numbers only")
    rates = [0.0, 0.0, 0.0]
    sign = 1.0 if options.counter_clockwise_positive else -1.0
    rates[_AXES[options.axis] - _AXES["x"]] = sign * rate_dps / RAD_TO_DEG
    numbers = ",".join(f"{value:+010.6f}" for value in rates)
    body = f"VNIMU,+00.2000,+00.0000,+00.4000,+00.000,+00.000,-09.807,{numbers},{temp_c:+05.1f},+101.325".encode()
    return b"$" + body + f"*{xor8(body):02X}\r\n".encode()


def messages(data: bytes) -> list[str]:
    """Names of the asynchronous messages in `data`, whatever they are."""
    return [name.decode() for name in _ANY_MESSAGE.findall(data)]


def command(body: str) -> bytes:
    """Command such as ``VNWRG,06,19`` with its check field and line end."""
    return f"${body}*{xor8(body.encode()):02X}\r\n".encode()
