"""What every gyro codec is: bytes in, frames out, and back; pure, incremental, never raising on any bytes."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

from gyrocal.bench.devices import StreamHealth

#: Status of a frame that the device calls good. Anything else is the device's own word for "do not trust".
GOOD = 0


@dataclass(frozen=True, slots=True)
class Frame:
    """One decoded message.

    Attributes
    ----------
    rate_dps : float
        Rate, deg/s; NaN where the frame carries none.
    temp_c : float
        Temperature of the gyro, deg C; NaN where the device does not send one.
    status : int
        0 is good; else the device's status bits.
    sequence : int or None
        The device's own counter.
    raw : bytes
        The message as received, so that a later discovery can be applied to old data.
    """

    rate_dps: float
    temp_c: float = math.nan
    status: int = GOOD
    sequence: int | None = None
    raw: bytes = b""


@dataclass(frozen=True, slots=True)
class Step:
    """What a look at the buffer found: bytes used up, and a frame, noise (`bad` False) or a damaged frame."""

    used: int
    frame: Frame | None = None
    bad: bool = False


class Decoder(ABC):
    """Incremental decoder: holds the bytes of an unfinished frame, and counts.

    Subclasses look at the buffer in `_look`; the loop, the counters and the sequence check are here.
    """

    #: Values that the device's counter takes before it returns to 0; None: it has no counter.
    sequence_modulus: int | None = None

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._bytes_in = self._skipped = self._good = self._bad = self._gaps = self._status_bad = 0
        self._in_sequence = 0
        self._last_sequence: int | None = None
        self._last_raw = b""

    @abstractmethod
    def _look(self, buffer: bytearray) -> Step | None:
        """The next step at the front of `buffer`; None when more bytes are needed to tell."""

    def feed(self, data: bytes) -> list[Frame]:
        """Frames completed by `data`, in order. Splitting the stream anywhere changes nothing."""
        self._bytes_in += len(data)
        self._buffer += data
        frames: list[Frame] = []
        while self._buffer and (step := self._look(self._buffer)) is not None:
            del self._buffer[: step.used]
            if step.frame is None:
                self._skipped += step.used
                self._bad += step.bad
                continue
            if self._repeats(step.frame):
                self._bad += 1
                continue
            self._count(step.frame)
            frames.append(step.frame)
        return frames

    def _repeats(self, frame: Frame) -> bool:
        """Whether a frame with a counter is the last one once more, as a faulty converter or radio link sends it."""
        return frame.sequence is not None and bool(frame.raw) and frame.raw == self._last_raw

    def _count(self, frame: Frame) -> None:
        self._good += 1
        self._last_raw = frame.raw
        self._status_bad += frame.status != GOOD
        if frame.sequence is not None and self.sequence_modulus is not None:
            if self._last_sequence is not None:
                follows = frame.sequence == (self._last_sequence + 1) % self.sequence_modulus
                self._in_sequence += follows
                self._gaps += not follows
            self._last_sequence = frame.sequence

    def health(self) -> StreamHealth:
        """Counters since the decoder was made."""
        return StreamHealth(
            self._bytes_in,
            self._skipped,
            self._good,
            self._bad,
            self._gaps,
            self._status_bad,
            in_sequence=self._in_sequence,
        )


class LineDecoder(Decoder):
    """Decoder of text lines ended by LF (CR before it is stripped).

    The first line after opening is dropped: it may have lost its beginning, and ``10.5`` cut to ``0.5`` looks sound.
    """

    #: A longer run of bytes without LF is noise: wrong baud or another device.
    max_line = 512

    def __init__(self) -> None:
        super().__init__()
        self._synchronised = False

    @abstractmethod
    def _parse(self, line: bytes) -> Frame | None:
        """Frame of a whole line without its end; None when it is damaged."""

    def _look(self, buffer: bytearray) -> Step | None:
        end = buffer.find(b"\n")
        if end < 0:
            if len(buffer) <= self.max_line:
                return None
            self._synchronised = False
            return Step(len(buffer), bad=True)
        line = bytes(buffer[: end + 1])
        if not self._synchronised:
            self._synchronised = True
            return Step(end + 1)
        if end > self.max_line:
            return Step(end + 1, bad=True)
        frame = self._parse(line.rstrip(b"\r\n"))
        return Step(end + 1, frame, bad=frame is None)
