"""Raw captures: every port's bytes while a run goes on, and the same codecs over them afterwards."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import StreamHealth
from gyrocal.bench.gyros.codec import Frame
from gyrocal.bench.registry import GYROS
from gyrocal.bench.schema import read_table
from gyrocal.errors import GyrocalError, InputError, OutputError
from gyrocal.records.files import raise_output_error, writing_atomically
from gyrocal.records.raw import RawWriter, is_cut_off, iterate_raw, read_raw_head

#: What a port calls with each chunk of bytes: direction (``b"<"`` came, ``b">"`` was sent) and the bytes.
Tap = Callable[[bytes, bytes], None]

_WRITE_PERIOD_S = 0.2


class RawCapture:
    """Captures of a run's ports. Bytes are queued at once and written by a thread of its own: no port waits for a disk.

    A capture that cannot be written (disk full) ends and is told of at `close`; the run goes on.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._heads: dict[str, tuple[str, Mapping[str, Any]]] = {}
        self._queue: deque[tuple[str, float, bool, bytes]] = deque()
        self._writers: dict[str, RawWriter] = {}
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self.failure: GyrocalError | None = None

    def tap(self, name: str, device: str, options: Mapping[str, Any]) -> Tap:
        """What the port of ``gyro``, ``table`` or ``chamber`` is to call; `device` and `options` head its file."""
        self._heads[name] = (device, options)

        def take(direction: bytes, data: bytes) -> None:
            if self.failure is None:
                self._queue.append((name, self._clock.now_s(), direction == b">", data))

        return take

    def start(self, folder: Path) -> None:
        """Begin ``NAME-N.raw`` in `folder`, with the first free N: a resumed run has several.

        Raises
        ------
        OutputError
            The folder or a file cannot be made.
        """
        try:
            folder.mkdir(exist_ok=True)
        except OSError as error:
            raise_output_error(folder, error)
        number = 1
        while any((folder / f"{name}-{number}.raw").exists() for name in self._heads):
            number += 1
        for name, (device, options) in self._heads.items():
            self._writers[name] = RawWriter(folder / f"{name}-{number}.raw", device, options)
        self._thread = threading.Thread(target=self._run, name="raw capture", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Write what is queued and close the files; never raises: see `failure`."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        try:
            for writer in self._writers.values():
                writer.close()
        except OutputError as error:
            self.failure = self.failure or error

    def _run(self) -> None:
        while not self._stop.wait(_WRITE_PERIOD_S):
            self._write_queued()
        self._write_queued()

    def _write_queued(self) -> None:
        try:
            while self._queue:
                name, t_s, sent, data = self._queue.popleft()
                self._writers[name].chunk(t_s, data, sent=sent)
            for writer in self._writers.values():
                writer.flush()
        except OutputError as error:
            self.failure = error
            self._queue.clear()


@dataclass(frozen=True)
class Decoded:
    """What a capture held, from its first bytes to its last; and whether it ends in the middle of a line."""

    device: str
    health: StreamHealth
    duration_s: float
    cut_off: bool


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
    first_s = t_s = math.nan
    with writing_atomically(out) as f:
        f.write(b"t_s,gyro_dps,gyro_temp_c,status,sequence\n")
        for t_s, data in iterate_raw(path):
            first_s = t_s if math.isnan(first_s) else first_s
            f.writelines(_row(t_s, frame) for frame in decoder.feed(data))
    duration_s = 0.0 if math.isnan(first_s) else t_s - first_s
    return Decoded(str(head["device"]), decoder.health(), duration_s, is_cut_off(path))


def _row(t_s: float, frame: Frame) -> bytes:
    def cell(value: float, digits: int) -> str:
        return "" if value != value else f"{value:.{digits}f}"

    sequence = "" if frame.sequence is None else str(frame.sequence)
    return f"{t_s:.6f},{cell(frame.rate_dps, 7)},{cell(frame.temp_c, 3)},{frame.status},{sequence}\n".encode()
