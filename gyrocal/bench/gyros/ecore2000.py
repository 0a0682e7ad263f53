"""KVH E-Core 2000 family, digital output (RD2100, RD2060): 8-byte frames, 100 Hz, output only.

Only the first byte of a frame has bit 7 set. The eight 7-bit groups make 56 bits, that is seven bytes m0..m6:
m0 closes the sum of all seven to 0 modulo 256, m5 m6 are the rate as a signed 16-bit number (protocols.md 1.1).
m1..m4 (status, self test, temperature) are not decoded by any public source: they are kept in ``Frame.raw``, and options
say which of them is the temperature once a capture has shown it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from gyrocal.bench.gyros.codec import Decoder, Frame, Step
from gyrocal.bench.schema import number

FRAME_BYTES = 8
_GROUP_BITS = 7
#: m1..m4 of the test vectors; what a real unit has there is not known.
OTHER = bytes.fromhex("12345678")


@dataclass(frozen=True)
class Options:
    """What the wire does not tell.

    Attributes
    ----------
    lsb_dps : float
        Rate of one count, deg/s: 0.00183 in the 60 deg/s unit, 0.000915 in the 30 deg/s unit. No default: a
        guessed scale is a wrong calibration.
    counter_clockwise_positive : bool
        Sign of the unit; not stated by the maker.
    temperature_byte : int
        Which of m1..m4 is the temperature; 0: not known, and the frames carry none.
    temperature_lsb_c, temperature_zero_c : float
        Temperature of one count, and at zero counts (the byte is unsigned).
    """

    lsb_dps: float = number(1e-9, 10.0, "deg/s")
    counter_clockwise_positive: bool = True
    temperature_byte: int = number(0, 4, "", 0)
    temperature_lsb_c: float = number(1e-6, 100.0, "deg C", 1.0)
    temperature_zero_c: float = number(-1000.0, 1000.0, "deg C", 0.0)


class ECore2000Decoder(Decoder):
    """Bytes of an E-Core 2000 to frames."""

    def __init__(self, options: Options) -> None:
        super().__init__()
        self._options = options
        self._lsb_dps = options.lsb_dps if options.counter_clockwise_positive else -options.lsb_dps

    def _look(self, buffer: bytearray) -> Step | None:
        if not buffer[0] & 0x80:
            return Step(_first_start(buffer, 0))
        start = _first_start(buffer[:FRAME_BYTES], 1)
        if start < min(len(buffer), FRAME_BYTES):
            return Step(start, bad=True)
        if len(buffer) < FRAME_BYTES:
            return None
        raw = bytes(buffer[:FRAME_BYTES])
        message = _join(raw)
        if sum(message) % 256:
            return Step(FRAME_BYTES, bad=True)
        counts = int.from_bytes(message[5:7], "big", signed=True)
        return Step(FRAME_BYTES, Frame(counts * self._lsb_dps, self._temperature_c(message), raw=raw))

    def _temperature_c(self, message: bytes) -> float:
        o = self._options
        if o.temperature_byte == 0:
            return math.nan
        return o.temperature_zero_c + o.temperature_lsb_c * message[o.temperature_byte]


def _first_start(buffer: bytearray, begin: int) -> int:
    """Index of the first byte at or after `begin` that can start a frame; the length when there is none."""
    return next((i for i in range(begin, len(buffer)) if buffer[i] & 0x80), len(buffer))


def _join(raw: bytes) -> bytes:
    """Seven message bytes of eight 7-bit groups."""
    bits = 0
    for byte in raw:
        bits = bits << _GROUP_BITS | byte & 0x7F
    return bits.to_bytes(7, "big")


def encode(counts: int, other: bytes = OTHER) -> bytes:
    """Frame of a rate in counts; `other` is m1..m4.

    Raises
    ------
    ValueError
        The counts do not fit 16 bits, or `other` is not four bytes.
    """
    if len(other) != 4:
        raise ValueError("m1..m4 are four bytes")
    try:
        body = other + counts.to_bytes(2, "big", signed=True)
    except OverflowError as error:
        raise ValueError(f"{counts} counts do not fit a signed 16-bit word") from error
    bits = int.from_bytes(bytes([-sum(body) % 256]) + body, "big")
    groups = [bits >> _GROUP_BITS * (7 - i) & 0x7F for i in range(FRAME_BYTES)]
    return bytes([groups[0] | 0x80, *groups[1:]])
