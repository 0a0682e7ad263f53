"""A gyro on a port, read in a thread of its own that never waits for disk, table or chamber."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import GyroSamples, StreamHealth
from gyrocal.bench.gyros.codec import Decoder, Frame
from gyrocal.bench.transport import Transport
from gyrocal.errors import DeviceError

#: Bits of a UART character: start, eight data, stop.
_BITS_PER_BYTE = 10
_LATENCY_REMEDY = "On an FTDI adapter set its latency timer to 1 ms: echo 1 > /sys/bus/usb-serial/devices/ttyUSB0/latency_timer"


@dataclass(frozen=True)
class StreamSpec:
    """What a stream is expected to be.

    Attributes
    ----------
    name : str
        Device and port, for messages.
    sample_rate_hz : float
        Nominal samples a second.
    baud : int
        Line speed, for the times of frames that arrive in one piece.
    silence_s : float
        Without a byte for so long the stream counts as gone.
    commands : tuple of bytes
        Sent once the port is open (mode selection).
    """

    name: str
    sample_rate_hz: float
    baud: int
    silence_s: float = 3.0
    commands: tuple[bytes, ...] = ()


class WireGyro:
    """Driver of any streaming gyro: a transport, a codec, a reading thread; see `gyrocal.bench.devices.Gyro`."""

    def __init__(
        self,
        spec: StreamSpec,
        open_transport: Callable[[], Transport],
        make_decoder: Callable[[], Decoder],
        clock: Clock,
        on_chunk: Callable[[float, bytes], None] | None = None,
    ) -> None:
        self._spec = spec
        self._open = open_transport
        self._make_decoder = make_decoder
        self._clock = clock
        self._on_chunk = on_chunk
        self._queue: deque[tuple[float, Frame]] = deque()
        self._decoder = make_decoder()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._failure: DeviceError | None = None
        self._last_byte_s = 0.0
        self._last_t_s = -np.inf

    def start(self) -> None:
        """Open the port and wait for the first good frame.

        Raises
        ------
        DeviceError
            No byte at all; bytes but no frame (wrong baud or another device); or frames that the device calls bad.
        """
        self._decoder = self._make_decoder()
        self._failure = None
        self._stop.clear()
        transport = self._open()
        for command in self._spec.commands:
            transport.write(command)
        self._last_byte_s = self._clock.now_s()
        self._thread = threading.Thread(
            target=self._read, args=(transport,), name=self._spec.name, daemon=True
        )
        self._thread.start()
        deadline_s = self._clock.now_s() + self._spec.silence_s
        while self._decoder.health().frames_good - self._decoder.health().status_bad < 1:
            if self._failure is not None or self._clock.now_s() > deadline_s:
                self.close()
                raise self._failure or DeviceError(self.verdict())
            self._clock.sleep(0.01)

    def verdict(self) -> str:
        """What is wrong with the stream, in one of three sentences."""
        health = self._decoder.health()
        if health.bytes_in == 0:
            return f"{self._spec.name}: no byte came within {self._spec.silence_s:g} s. Check power, cable and port."
        if health.frames_good == 0:
            return (
                f"{self._spec.name}: {health.bytes_in} bytes came and no frame among them. "
                "The baud rate is wrong, or it is another device."
            )
        return (
            f"{self._spec.name}: {health.frames_good} frames came, and the device calls {health.status_bad} of them bad. "
            "See its status bits; let it warm up or replace it."
        )

    def drain(self) -> GyroSamples:
        """Samples since the last call.

        Raises
        ------
        DeviceError
            The port is gone, or has been silent for too long; the samples before that were handed out.
        """
        count = len(self._queue)
        if count == 0:
            if self._failure is not None:
                raise self._failure
            silent_s = self._clock.now_s() - self._last_byte_s
            if silent_s > self._spec.silence_s:
                raise DeviceError(
                    f"{self._spec.name}: has been silent for {silent_s:.1f} s. Check power, cable and port."
                )
            return GyroSamples()
        rows = [self._queue.popleft() for _ in range(count)]
        return GyroSamples(
            np.array([t_s for t_s, _ in rows]),
            np.array([frame.rate_dps for _, frame in rows]),
            np.array([frame.temp_c for _, frame in rows]),
            np.array([float(frame.status) for _, frame in rows]),
        )

    def health(self) -> StreamHealth:
        """Counters since `start`."""
        return self._decoder.health()

    def close(self) -> None:
        """Stop the thread and close the port; never raises."""
        self._stop.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            # A port that hangs in close must not hold up the safety actions.
            self._thread.join(timeout=1.0)

    def _read(self, transport: Transport) -> None:
        try:
            while not self._stop.is_set():
                data = transport.read_available(0.05)
                if data:
                    self._take(self._clock.now_s(), data)
        except DeviceError as error:
            self._failure = error
        finally:
            transport.close()

    def _take(self, now_s: float, data: bytes) -> None:
        self._last_byte_s = now_s
        if self._on_chunk is not None:
            self._on_chunk(now_s, data)
        frames = self._decoder.feed(data)
        # Frames read in one piece came one after the other on the line: each is dated by the bytes behind it.
        behind = 0
        times_s = []
        for frame in reversed(frames):
            times_s.append(now_s - behind * _BITS_PER_BYTE / self._spec.baud)
            behind += len(frame.raw)
        for t_s, frame in zip(reversed(times_s), frames, strict=True):
            self._last_t_s = max(t_s, self._last_t_s)
            self._queue.append((self._last_t_s, frame))


@dataclass(frozen=True)
class StreamLimits:
    """Shares of a segment above which its stream is not good enough to calibrate with."""

    bad_share: float = 0.02
    gap_share: float = 0.01
    #: Free-running gyros send up to 3 % slower than nominal, so without a counter only more than this is loss.
    missing_share: float = 0.05
    clump_share: float = 0.2


def judge_stream(
    t_s: np.ndarray[tuple[int], np.dtype[np.float64]],
    before: StreamHealth,
    after: StreamHealth,
    sample_rate_hz: float,
    limits: StreamLimits,
) -> str | None:
    """Why the stream of a segment is not good enough; None when it is.

    Parameters
    ----------
    t_s : ndarray, shape (n,)
        Arrival times of the segment's samples, s.
    before, after : StreamHealth
        Counters at the segment's two ends.
    sample_rate_hz : float
        Nominal samples a second.

    Notes
    -----
    A gap is a pair of samples more than 1.8 nominal periods apart that no clump explains: lost samples are counted
    from the number that came over the time they took. Clumped are samples that follow each other within a fifth of a
    period.
    """
    if t_s.size < 2:
        return f"only {t_s.size} samples came; check the gyro's data rate"
    good = after.frames_good - before.frames_good
    bad = after.frames_bad - before.frames_bad
    if bad > limits.bad_share * max(1, good + bad):
        return f"{bad} of {good + bad} frames were damaged ({bad / (good + bad):.1%}); check cable, grounding and baud rate"
    steps_s = np.diff(t_s)
    clumped = float(np.mean(steps_s < 0.2 / sample_rate_hz))
    if clumped > limits.clump_share:
        return (
            f"{clumped:.0%} of the samples arrived in clumps, so their times are not known. {_LATENCY_REMEDY}"
        )
    sequence_gaps = after.sequence_gaps - before.sequence_gaps
    expected = (t_s[-1] - t_s[0]) * sample_rate_hz + 1
    lost = max(0.0, 1.0 - t_s.size / expected)
    if lost > limits.missing_share or sequence_gaps / max(1, good) > limits.gap_share:
        return (
            f"{t_s.size} samples came where {expected:.0f} were due, with {sequence_gaps} gaps in the device's counter; "
            "check the data rate against the line speed, and other load on this computer"
        )
    return None
