"""Decoding of raw captures: the same codecs as on the bench, over bytes that were stored."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gyrocal.bench.devices import StreamHealth
from gyrocal.bench.gyros.codec import Frame
from gyrocal.bench.registry import GYROS
from gyrocal.bench.schema import read_table
from gyrocal.errors import InputError
from gyrocal.records.files import writing_atomically
from gyrocal.records.raw import iterate_raw, read_raw_head


@dataclass(frozen=True)
class Decoded:
    """What a capture held."""

    device: str
    health: StreamHealth
    duration_s: float


def decode_capture(path: Path, out: Path) -> Decoded:
    """Decode a gyro's capture to CSV: ``t_s, gyro_dps, gyro_temp_c, status, sequence``, a row a frame.

    Raises
    ------
    InputError
        Not a capture, or of a device that has no gyro codec.
    OutputError
        `out` cannot be written.
    """
    head = read_raw_head(path)
    kind = GYROS.get(str(head.get("device")))
    if kind is None:
        raise InputError(
            f"{path}: is of {head.get('device')!r}, and only gyros are decoded ({', '.join(GYROS)})."
        )
    decoder = kind.decoder(read_table(kind.options, head.get("options", {}), str(path), "options"))
    t_s = 0.0
    with writing_atomically(out) as f:
        f.write(b"t_s,gyro_dps,gyro_temp_c,status,sequence\n")
        for t_s, data in iterate_raw(path):
            f.writelines(_row(t_s, frame) for frame in decoder.feed(data))
    return Decoded(str(head["device"]), decoder.health(), t_s)


def _row(t_s: float, frame: Frame) -> bytes:
    def cell(value: float, digits: int) -> str:
        return "" if value != value else f"{value:.{digits}f}"

    sequence = "" if frame.sequence is None else str(frame.sequence)
    return f"{t_s:.6f},{cell(frame.rate_dps, 7)},{cell(frame.temp_c, 3)},{frame.status},{sequence}\n".encode()
