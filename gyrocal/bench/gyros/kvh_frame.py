"""KVH FE81FF55 frames, formats A and B: 1725/1750/1775 IMU and DSP-1760 (protocols.md 1.5).

Format A (36 bytes): header, rotation X Y Z and acceleration X Y Z as float32, status, sequence, temperature, CRC.
Format B (40 bytes): the same with a microsecond time stamp before the status. All big-endian. The CRC is
CRC-32/MPEG-2 over everything before it. Answers to ``?BIT`` come inside the stream and are stepped over.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from gyrocal.bench.gyros.codec import GOOD, Decoder, Frame, Step
from gyrocal.bench.schema import choice, number
from gyrocal.units import RAD_TO_DEG

HEADER_A = bytes.fromhex("FE81FF55")
HEADER_B = bytes.fromhex("FE81FF56")
_LENGTHS = {HEADER_A: 36, HEADER_B: 40}
#: Answers to ?BIT and ?BIT,2: header, length with a final byte that is the sum of all before it.
_BIT_LENGTHS = {bytes.fromhex("FE8100AA"): 11, bytes.fromhex("FE8100AB"): 13}
_HEADERS = (*_LENGTHS, *_BIT_LENGTHS)
_AXES = {"x": 0, "y": 1, "z": 2}


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte << 24
        for _ in range(8):
            crc = (crc << 1 ^ 0x04C11DB7 if crc & 0x80000000 else crc << 1) & 0xFFFFFFFF
        table.append(crc)
    return tuple(table)


_TABLE = _crc_table()


def crc32_mpeg2(data: bytes) -> int:
    """CRC-32/MPEG-2: polynomial 04C11DB7, start FFFFFFFF, not reflected, no final xor."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc = crc << 8 & 0xFFFFFFFF ^ _TABLE[crc >> 24 ^ byte]
    return crc


@dataclass(frozen=True)
class Options:
    """How the device was configured; `rotation_is_delta` and whole degrees are the factory settings.

    Attributes
    ----------
    axis : {"x", "y", "z"}
        Axis on the table.
    data_rate_hz : float
        Messages a second (``?DR``); turns a delta angle into a rate.
    rotation_is_delta, rotation_in_radians : bool
        ``ROTFMT`` and ``ROTUNITS``.
    temperature_lsb_c : float
        1 for ``TEMPUNITS,C``, 0.01 for ``TEMPUNITS,C_100``, which a calibration should use.
    counter_clockwise_positive : bool
        Sign of the axis as mounted.
    """

    axis: str = choice(*_AXES, default="z")
    data_rate_hz: float = number(0.1, 10000.0, "Hz", 1000.0)
    rotation_is_delta: bool = True
    rotation_in_radians: bool = True
    temperature_lsb_c: float = number(1e-6, 10.0, "deg C", 0.01)
    counter_clockwise_positive: bool = True

    @property
    def dps_per_unit(self) -> float:
        """Rate in deg/s of one unit of the rotation word."""
        scale = RAD_TO_DEG if self.rotation_in_radians else 1.0
        scale *= self.data_rate_hz if self.rotation_is_delta else 1.0
        return scale if self.counter_clockwise_positive else -scale


class KvhFrameDecoder(Decoder):
    """Bytes of a KVH IMU or DSP-1760 to frames."""

    sequence_modulus = 128

    def __init__(self, options: Options) -> None:
        super().__init__()
        self._axis = _AXES[options.axis]
        self._scale = options.dps_per_unit
        self._temp_lsb_c = options.temperature_lsb_c

    def _look(self, buffer: bytearray) -> Step | None:
        start = _header_start(buffer)
        if start:
            return Step(start)
        if len(buffer) < len(HEADER_A):
            return None
        header = bytes(buffer[:4])
        if header in _BIT_LENGTHS:
            return _look_bit_answer(buffer, _BIT_LENGTHS[header])
        length = _LENGTHS[header]
        if len(buffer) < length:
            return None
        raw = bytes(buffer[:length])
        if crc32_mpeg2(raw[:-4]) != int.from_bytes(raw[-4:], "big"):
            # A true header may lie inside the damaged stretch: go on just behind this one.
            return Step(1, bad=True)
        return Step(length, self._decode(raw))

    def _decode(self, raw: bytes) -> Frame:
        (rotation,) = struct.unpack_from(">f", raw, 4 + 4 * self._axis)
        status, sequence, temperature = struct.unpack_from(">BBh", raw, len(raw) - 8)
        valid = status >> self._axis & 1 and math.isfinite(rotation)
        return Frame(
            rotation * self._scale if math.isfinite(rotation) else math.nan,
            temperature * self._temp_lsb_c,
            GOOD if valid else (status ^ 0x77) or 0x80,
            sequence,
            raw,
        )


def _header_start(buffer: bytearray) -> int:
    """Index where a header, or the beginning of one at the end of the buffer, starts."""
    position = buffer.find(0xFE)
    while position >= 0:
        piece = bytes(buffer[position : position + 4])
        if any(header.startswith(piece) for header in _HEADERS):
            return position
        position = buffer.find(0xFE, position + 1)
    return len(buffer)


def _look_bit_answer(buffer: bytearray, length: int) -> Step | None:
    if len(buffer) < length:
        return None
    if sum(buffer[: length - 1]) % 256 == buffer[length - 1]:
        return Step(length)
    return Step(1, bad=True)


def encode(
    rate_dps: float,
    temp_c: float,
    sequence: int,
    options: Options,
    *,
    time_us: int | None = None,
    valid: bool = True,
) -> bytes:
    """Frame of a rate on the configured axis; format B when `time_us` is given, else A."""
    rotation = [0.0, 0.0, 0.0]
    rotation[_AXES[options.axis]] = rate_dps / options.dps_per_unit
    status = 0x77 if valid else 0x77 & ~(1 << _AXES[options.axis])
    body = (HEADER_A if time_us is None else HEADER_B) + struct.pack(">6f", *rotation, 0.0, 0.0, -1.0)
    if time_us is not None:
        body += struct.pack(">I", time_us % 2**32)
    body += struct.pack(">BBh", status, sequence % 128, round(temp_c / options.temperature_lsb_c))
    return body + crc32_mpeg2(body).to_bytes(4, "big")
