"""A gyro on a port, read in a thread of its own that never waits for disk, table or chamber."""

from __future__ import annotations

import threading
from array import array
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import bdtrc

from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import GyroSamples, StreamHealth
from gyrocal.bench.gyros.codec import Decoder
from gyrocal.bench.schema import number
from gyrocal.bench.transport import Transport
from gyrocal.errors import DeviceError

#: Bits of a UART character: start, eight data, stop.
_BITS_PER_BYTE = 10
#: Samples closer than this share of a period came in a clump; a pause of more than so many periods, and not longer than
#: a latency timer of 16 ms lets it be, lies between clumps.
_CLOSE, _PAUSE, _LATENCY_S = 0.2, 6.0, 0.02
#: At a segment's end so much may still be on its way, s.
_TAIL_S = 0.5
#: A line that is just good enough fails so many of its segments.
_BY_CHANCE = 0.01
#: Runs of equal samples between a quarter and a half of the longest that a coarse output has: tens for a longest run
#: whose like comes once. Of 2,000 sound segments with a run of 100 or more, steps 1.7 to 7 times the noise, 62 had fewer.
_SHORTER_RUNS = 4
_LATENCY_REMEDY = (
    "On an FTDI adapter set its latency timer to 1 ms: echo 1 > /sys/bus/usb-serial/devices/ttyUSB0/latency_timer; "
    "else take other load off this computer"
)


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
        Sent once the port is open (mode selection), and again after a pause: the device may have restarted.
    pause_s : float
        Without a byte for so long, and few after it, the device counts as restarted.
    """

    name: str
    sample_rate_hz: float
    baud: int
    silence_s: float = 3.0
    commands: tuple[bytes, ...] = ()
    pause_s: float = 0.5


class WireGyro:
    """Driver of any streaming gyro: a transport, a codec, a reading thread; see `gyrocal.bench.devices.Gyro`.

    Without a thread (`threaded` False) whoever owns the port hands the bytes to `take`.
    """

    def __init__(
        self,
        spec: StreamSpec,
        open_transport: Callable[[], Transport],
        make_decoder: Callable[[], Decoder],
        clock: Clock,
        *,
        threaded: bool = True,
    ) -> None:
        self._spec = spec
        self._open = open_transport
        self._make_decoder = make_decoder
        self._clock = clock
        self._threaded = threaded
        #: Four numbers a sample, flat: an operator may take an hour to answer a question, at a kilohertz.
        self._rows = array("d")
        self._lock = threading.Lock()
        self._decoder = make_decoder()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._transport: Transport | None = None
        self._failure: DeviceError | None = None
        self._first_byte_s: float | None = None
        #: A pause that is not judged yet: its two ends, bytes before it, and bytes a second until then.
        self._paused: tuple[float, float, int, float] | None = None
        self._last_byte_s = 0.0
        self._restarts = 0
        self._last_t_s = -np.inf

    def start(self) -> None:
        """Open the port and wait for the first good frame.

        Raises
        ------
        DeviceError
            No byte at all; bytes but no frame (wrong baud or another device); or frames that the device calls bad.
        """
        self._decoder = self._make_decoder()
        self._failure = self._first_byte_s = self._paused = None
        self._restarts = 0
        self._taken()
        # A thread that hung in its port when it was closed keeps its own, set event.
        stop = self._stop = threading.Event()
        transport = self._transport = self._open()
        self._last_byte_s = self._clock.now_s()
        for command in self._spec.commands:
            transport.write(command)
        if self._threaded:
            self._thread = threading.Thread(
                target=self._read, args=(transport, stop), name=self._spec.name, daemon=True
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
        rows = self._taken()
        if not rows:
            if self._failure is not None:
                raise self._failure
            silent_s = self._clock.now_s() - self._last_byte_s
            if silent_s > self._spec.silence_s:
                raise DeviceError(
                    f"{self._spec.name}: has been silent for {silent_s:.1f} s. Check power, cable and port."
                )
            return GyroSamples()
        return GyroSamples(*np.array(rows).reshape(-1, 4).T)

    def _taken(self) -> array[float]:
        """The rows that came since the last call."""
        with self._lock:
            rows, self._rows = self._rows, array("d")
        return rows

    def health(self) -> StreamHealth:
        """Counters since `start`."""
        return replace(self._decoder.health(), restarts=self._restarts)

    def close(self) -> None:
        """Stop the thread and close the port; never raises."""
        self._stop.set()
        if not self._threaded and self._transport is not None:
            self._transport.close()
        if self._thread is not None and self._thread is not threading.current_thread():
            # A port that hangs in close must not hold up the safety actions.
            self._thread.join(timeout=1.0)

    def _read(self, transport: Transport, stop: threading.Event) -> None:
        try:
            while not stop.is_set():
                data = transport.read_available(0.05)
                if data and not stop.is_set():
                    self.take(self._clock.now_s(), data)
        except DeviceError as error:
            if not stop.is_set():
                self._failure = error
        finally:
            transport.close()

    def take(self, now_s: float, data: bytes) -> None:
        """Decode bytes that arrived at `now_s`, s.

        Raises
        ------
        DeviceError
            The device restarted, and its mode cannot be sent again.
        """
        self._notice_restart(now_s)
        self._last_byte_s = now_s
        frames = self._decoder.feed(data)
        # Frames read in one piece came one after the other on the line: each is dated by the bytes behind it.
        behind = 0
        times_s = []
        for frame in reversed(frames):
            times_s.append(now_s - behind * _BITS_PER_BYTE / self._spec.baud)
            behind += len(frame.raw)
        for t_s, frame in zip(reversed(times_s), frames, strict=True):
            self._last_t_s = max(t_s, self._last_t_s)
            with self._lock:
                self._rows.extend((self._last_t_s, frame.rate_dps, frame.temp_c, frame.status))

    def _notice_restart(self, now_s: float) -> None:
        """After a pause the device may be back in its power-up mode: send the commands again.

        When something else was kept waiting, not the device, the bytes of the pause come late but do come: so it is
        judged a moment after the pause, by how many came.
        """
        bytes_in = self._decoder.health().bytes_in
        if self._first_byte_s is None:
            self._first_byte_s = now_s
        elif self._paused is None and now_s - self._last_byte_s > self._spec.pause_s:
            streamed_s = max(self._last_byte_s - self._first_byte_s, 1.0 / self._spec.sample_rate_hz)
            self._paused = (self._last_byte_s, now_s, bytes_in, bytes_in / streamed_s)
        elif self._paused is not None and now_s - self._paused[1] >= 0.5 * self._spec.pause_s:
            begin_s, _, before, bytes_per_s = self._paused
            self._paused = None
            if bytes_in - before < 0.6 * bytes_per_s * (now_s - begin_s):
                self._restarts += 1
                for command in self._spec.commands:
                    if self._transport is not None:
                        self._transport.write(command)


@dataclass(frozen=True)
class StreamLimits:
    """Shares of a segment above which its stream is not good enough to calibrate with.

    Attributes
    ----------
    bad_share : float
        Damaged frames, and frames that the device itself calls bad.
    gap_share : float
        Gaps in the device's counter, of all frames.
    missing_share : float
        Samples that did not come. Free-running gyros send up to 3 % slower than nominal, so only more is loss.
    surplus_share : float
        Samples beyond those that were due: the device's data rate is not ``sensor.sample_rate_hz``.
    clump_share : float
        Samples that arrived less than a fifth of a period after the one before. On a fast line the frames of a clump
        lie farther apart; there it counts when half of the time goes in the pauses of a 16 ms latency timer. Where the
        device numbers its frames and none is missing, clumps are told and fail nothing.
    stuck_samples : int
        So many equal samples in a row are a stuck output, unless the segment has shorter runs of all lengths, as an
        output whose steps are coarser than its noise has them; 0: never.
    """

    bad_share: float = number(0.0, 1.0, "", 0.02)
    gap_share: float = number(0.0, 1.0, "", 0.01)
    missing_share: float = number(0.0, 1.0, "", 0.05)
    surplus_share: float = number(0.0, 1000.0, "", 0.25)
    clump_share: float = number(0.0, 1.0, "", 0.2)
    stuck_samples: int = number(0, 10**9, "", 100)


class StreamTally:
    """What a segment's samples say about the stream, counted as they come."""

    def __init__(self, sample_rate_hz: float) -> None:
        self._period_s = 1.0 / sample_rate_hz
        self.n = 0
        #: Runs of equal values that have ended, by length.
        self._ended: Counter[int] = Counter()
        #: Sum of the rates that the device calls good, and their number.
        self.good_dps, self.good = 0.0, 0
        self.clumped = 0
        #: Time that went in pauses as a latency timer makes them; a busy computer makes some too, but not most of the time.
        self.paused_s = 0.0
        self.first_t_s = self.last_t_s = np.nan
        self._last_dps = np.nan
        self._run = 0

    def add(self, samples: GyroSamples) -> None:
        """Count samples, in order of time."""
        n = samples.t_s.size
        if n == 0:
            return
        steps_s = np.diff(samples.t_s, prepend=self.last_t_s)
        self.clumped += int(np.count_nonzero(steps_s < _CLOSE * self._period_s))
        self.paused_s += float(np.sum(steps_s[(steps_s > _PAUSE * self._period_s) & (steps_s < _LATENCY_S)]))
        self.first_t_s = samples.t_s[0] if self.n == 0 else self.first_t_s
        self.n += n
        good = samples.gyro_dps[(samples.status == 0) & np.isfinite(samples.gyro_dps)]
        self.good_dps, self.good = self.good_dps + float(good.sum()), self.good + good.size
        # The first run may go on from before, the last may go on behind.
        starts = np.flatnonzero(np.diff(samples.gyro_dps, prepend=self._last_dps) != 0)
        if starts.size == 0:
            self._run += n
        else:
            self._ended.update([self._run + int(starts[0]), *np.diff(starts).tolist()])
            self._run = n - int(starts[-1])
        self.last_t_s, self._last_dps = samples.t_s[-1], samples.gyro_dps[-1]

    @property
    def longest_run(self) -> int:
        """Most equal values in a row."""
        return max([self._run, *self._ended])

    def shorter_runs(self) -> int:
        """Runs between a quarter and a half of the longest."""
        longest = self.longest_run
        return sum(count for run, count in self._ended.items() if longest <= 4 * run <= 2 * longest)

    def mean_dps(self) -> float:
        """Mean of what the device calls good; NaN where there is nothing."""
        return self.good_dps / self.good if self.good else np.nan


def judge_stream(
    tally: StreamTally,
    before: StreamHealth,
    after: StreamHealth,
    sample_rate_hz: float,
    limits: StreamLimits,
    *,
    duration_s: float,
) -> str | None:
    """Why the stream of a segment is not good enough, with the remedy; None when it is.

    Parameters
    ----------
    before, after : StreamHealth
        Counters at the segment's two ends.
    sample_rate_hz : float
        Nominal samples a second.
    duration_s : float
        Length of the segment: a stream that ended in it lacks samples too.
    """
    if tally.n < 2:
        return f"only {tally.n} samples came; check the gyro's data rate"
    seen = after.since(before)
    good, bad, called_bad, gaps = seen.frames_good, seen.frames_bad, seen.status_bad, seen.sequence_gaps
    if seen.restarts:
        return f"the gyro paused and started again {seen.restarts} times, and its mode was sent again; check its supply"
    if _beyond(bad, good + bad, limits.bad_share):
        return f"{bad} of {good + bad} frames were damaged ({bad / (good + bad):.1%}); check cable, grounding and baud rate"
    if _beyond(called_bad, good, limits.bad_share):
        return f"the gyro calls {called_bad} of {good} samples bad; see its status bits, and let it warm up or replace it"
    if 0 < limits.stuck_samples <= tally.longest_run and tally.shorter_runs() < _SHORTER_RUNS:
        return f"the gyro gave the same value {tally.longest_run} times in a row; it is stuck, or stream.stuck_samples is too low for its resolution"
    came_in_s = tally.last_t_s - tally.first_t_s
    expected = max(came_in_s, duration_s - _TAIL_S) * sample_rate_hz + 1
    lost = max(0.0, 1.0 - tally.n / expected)
    # A damaged frame leaves a gap too, and was judged above.
    if lost > limits.missing_share or _beyond(gaps - bad, good, limits.gap_share):
        return (
            f"{tally.n} samples came where {expected:.0f} were due, with {gaps} gaps in the device's counter; "
            "check the cable, the data rate against the line speed, and other load on this computer"
        )
    if tally.n > (1.0 + limits.surplus_share) * (came_in_s * sample_rate_hz + 1):
        return (
            f"{tally.n} samples came in {came_in_s:.3g} s, more than there are at {sample_rate_hz:g} Hz; set sensor.sample_rate_hz to the "
            "data rate of the device, on which the scale of its rate may hang"
        )
    # Samples that the device numbered without a gap are all there and evenly spaced, however late they were read.
    numbered = seen.in_sequence >= good
    return None if numbered else clumps(tally, limits)


def _beyond(count: int, n: int, share: float) -> bool:
    """Whether `count` of `n` are more than a share of them, and more than chance makes of that share in a short segment."""
    return count > share * n and float(bdtrc(count - 1, n, share)) < _BY_CHANCE


def clumps(tally: StreamTally, limits: StreamLimits) -> str | None:
    """How much of a segment's stream came in clumps, with the remedy; None where that is little."""
    clumped, came_in_s = tally.clumped / max(1, tally.n - 1), tally.last_t_s - tally.first_t_s
    if clumped > limits.clump_share:
        seen = f"{clumped:.0%} of the samples arrived in clumps"
    elif tally.paused_s > 0.5 * came_in_s:
        seen = f"{tally.paused_s / came_in_s:.0%} of the time went in pauses between clumps of samples"
    else:
        return None
    return f"{seen}, so their times are not known. {_LATENCY_REMEDY}"
