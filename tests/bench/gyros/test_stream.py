"""The reading thread: frames in, three different verdicts, health judged by segment."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from gyrocal.bench.devices import GyroSamples, StreamHealth
from gyrocal.bench.gyros import kvh_frame
from gyrocal.bench.gyros.stream import StreamLimits, StreamSpec, StreamTally, WireGyro, judge_stream
from gyrocal.errors import DeviceError

OPTIONS = kvh_frame.Options()


class ChunkTransport:
    """Hands out chunks, then is silent or gone."""

    def __init__(self, chunks: list[bytes], *, then_gone: bool = False) -> None:
        self._chunks = chunks
        self._then_gone = then_gone
        self.written: list[bytes] = []
        self.closed = threading.Event()
        self.empty = threading.Event()

    def now_s(self) -> float:
        return 0.0

    def write(self, data: bytes) -> None:
        self.written.append(data)

    def read_available(self, wait_s: float) -> bytes:
        if self._chunks:
            return self._chunks.pop(0)
        self.empty.set()
        if self._then_gone:
            raise DeviceError("/dev/ttyX: the port is gone while reading. Check the cable.")
        self.closed.wait(min(wait_s, 0.005))
        return b""

    def close(self) -> None:
        self.closed.set()


class Hand:
    """A clock moved by hand."""

    def __init__(self) -> None:
        self.t_s = 0.0

    def now_s(self) -> float:
        return self.t_s

    def sleep(self, duration_s: float) -> None:
        self.t_s += duration_s


class Patient(Hand):
    """A clock that goes on only when all was read that a port has: how busy the machine is does not matter."""

    def __init__(self, transport: ChunkTransport) -> None:
        super().__init__()
        self._transport = transport

    def sleep(self, duration_s: float) -> None:
        assert self._transport.empty.wait(60.0)
        super().sleep(duration_s)


def gyro(transport: ChunkTransport) -> WireGyro:
    spec = StreamSpec("kvh-frame-a on /dev/ttyX", 1000.0, 921600, 0.15, (b"R",))
    return WireGyro(spec, lambda: transport, lambda: kvh_frame.KvhFrameDecoder(OPTIONS), Patient(transport))


def frames(count: int, *, valid: bool = True) -> bytes:
    return b"".join(kvh_frame.encode(10.0, 25.0, i % 128, OPTIONS, valid=valid) for i in range(count))


def test_samples_come_in_order_with_times_from_arrival() -> None:
    transport = ChunkTransport([frames(5), frames(5)[:50], frames(5)[50:]])
    device = gyro(transport)
    device.start()
    assert transport.empty.wait(60.0)
    samples = device.drain()
    device.close()
    assert samples.gyro_dps == pytest.approx(np.full(10, 10.0), rel=1e-6)
    assert samples.gyro_temp_c == pytest.approx(np.full(10, 25.0))
    steps_s = np.diff(samples.t_s[:5])
    assert steps_s == pytest.approx(np.full(4, 36 * 10 / 921600), rel=1e-6)
    assert np.all(np.diff(samples.t_s) >= 0)
    assert transport.written == [b"R"]
    assert transport.closed.is_set()


@pytest.mark.parametrize(
    ("chunks", "text"),
    [
        ([], "no byte came within"),
        ([b"\x13" * 500], "500 bytes came and no frame among them"),
        ([frames(20, valid=False)], "the device calls 20 of them bad"),
    ],
)
def test_three_different_verdicts(chunks: list[bytes], text: str) -> None:
    with pytest.raises(DeviceError, match=text):
        gyro(ChunkTransport(chunks)).start()


def test_a_port_that_vanishes_is_told_after_its_samples_were_handed_out() -> None:
    transport = ChunkTransport([frames(3)], then_gone=True)
    device = gyro(transport)
    device.start()
    assert transport.closed.wait(60.0)
    assert device.drain().t_s.size == 3
    with pytest.raises(DeviceError, match="the port is gone"):
        device.drain()
    device.close()


def test_a_silent_gyro_is_told() -> None:
    transport = ChunkTransport([frames(3)])
    device = gyro(transport)
    device.start()
    assert transport.empty.wait(60.0)
    assert device.drain().t_s.size == 3
    device._clock.sleep(0.2)
    with pytest.raises(DeviceError, match="has been silent for"):
        device.drain()
    device.close()


STEADY = np.arange(1000) / 100.0
NONE = StreamHealth()


@pytest.mark.parametrize(
    ("t_s", "after", "text"),
    [
        (STEADY, StreamHealth(frames_good=1000), None),
        (STEADY * 1.03, StreamHealth(frames_good=1000), None),
        (STEADY, StreamHealth(frames_good=1000, frames_bad=50), "50 of 1050 frames were damaged"),
        (np.repeat(STEADY[::10], 10), StreamHealth(frames_good=1000), "latency_timer"),
        # by a counter nothing is missing: samples were read late, by a busy computer perhaps
        (np.repeat(STEADY[::10], 10), StreamHealth(frames_good=1000, in_sequence=1000), None),
        (np.repeat(STEADY[::10], 10), StreamHealth(frames_good=1000, in_sequence=999), "latency_timer"),
        (STEADY[:1], StreamHealth(frames_good=1), "only 1 samples came"),
        (
            np.delete(STEADY, slice(100, 200)),
            StreamHealth(frames_good=900),
            "900 samples came where 1000 were due",
        ),
        (STEADY, StreamHealth(frames_good=1000, sequence_gaps=20), "20 gaps in the device's counter"),
        (STEADY, StreamHealth(frames_good=1000, status_bad=50), "the gyro calls 50 of 1000 samples bad"),
        (STEADY * 0.85, StreamHealth(frames_good=1000), None),
        (
            STEADY * 0.5,
            StreamHealth(frames_good=1000),
            "1000 samples came in 5 s, more than there are at 100 Hz; set sensor",
        ),
        (STEADY, StreamHealth(frames_good=1000, restarts=1), "paused and started again 1 times"),
    ],
)
def test_a_segment_is_judged(
    t_s: np.ndarray[tuple[int], np.dtype[np.float64]], after: StreamHealth, text: str | None
) -> None:
    tally = StreamTally(100.0)
    for part in np.array_split(t_s, 7):
        tally.add(GyroSamples(part, np.random.default_rng(1).normal(size=part.size), part, part))
    verdict = judge_stream(tally, NONE, after, 100.0, StreamLimits(), duration_s=float(np.ptp(t_s)))
    assert (verdict is None) if text is None else (verdict is not None and text in verdict)


@pytest.mark.parametrize(("share", "low", "high"), [(0.01, 0.0, 0.002), (0.02, 0.0, 0.015), (0.1, 0.55, 1.0)])
@pytest.mark.parametrize("n", [60, 1000])
def test_short_segments_are_not_failed_by_chance(share: float, low: float, high: float, n: int) -> None:
    """By default 2 % of the frames may be damaged: of 2,000 segments of a line that damages a share, so many fail."""
    tally = StreamTally(100.0)
    t_s = np.arange(n) / 100.0
    tally.add(GyroSamples(t_s, np.random.default_rng(1).normal(size=n), t_s, t_s))
    damaged = np.bincount(np.random.default_rng(3).binomial(n, share, 2000))
    failed = sum(
        times
        for bad, times in enumerate(damaged)
        if judge_stream(
            tally,
            NONE,
            StreamHealth(frames_good=n - bad, frames_bad=bad),
            100.0,
            StreamLimits(),
            duration_s=n / 100.0,
        )
    )
    assert low <= failed / 2000 <= high


def test_a_stream_that_ends_in_a_segment_lacks_samples() -> None:
    tally = StreamTally(100.0)
    part = STEADY[:700]
    tally.add(GyroSamples(part, np.random.default_rng(1).normal(size=part.size), part, part))
    after = StreamHealth(frames_good=700)
    assert judge_stream(tally, NONE, after, 100.0, StreamLimits(), duration_s=7.4) is None
    verdict = judge_stream(tally, NONE, after, 100.0, StreamLimits(), duration_s=10.0)
    assert verdict is not None
    assert "700 samples came where 951 were due" in verdict


@pytest.mark.parametrize(("latency_s", "clumped"), [(0.001, False), (0.016, True)])
def test_the_latency_timer_is_seen_at_a_kilohertz(latency_s: float, clumped: bool) -> None:
    """An FTDI adapter hands its bytes over every 16 ms; on a fast line its frames then lie 0.4 ms apart."""
    clock = Hand()
    spec = StreamSpec("kvh-frame-a on /dev/ttyX", 1000.0, 921600)
    device = WireGyro(
        spec, lambda: ChunkTransport([]), lambda: kvh_frame.KvhFrameDecoder(OPTIONS), clock, threaded=False
    )
    for n in range(1, round(1.0 / latency_s)):
        device.take(n * latency_s, frames(round(1000 * latency_s)))
    tally = StreamTally(1000.0)
    tally.add(device.drain())
    after = StreamHealth(frames_good=tally.n)
    verdict = judge_stream(tally, NONE, after, 1000.0, StreamLimits(stuck_samples=0), duration_s=1.0)
    assert (verdict is not None and "latency_timer" in verdict) == clumped


@pytest.mark.parametrize("pieces", [1, 3, 50])
@pytest.mark.parametrize(("equal", "stuck"), [(99, False), (100, True), (137, True)])
def test_a_stuck_output_is_seen_across_drains(pieces: int, equal: int, stuck: bool) -> None:
    values = np.random.default_rng(2).normal(size=1000)
    values[400 : 400 + equal] = 1.25
    tally = StreamTally(100.0)
    for t_s, gyro_dps in zip(np.array_split(STEADY, pieces), np.array_split(values, pieces), strict=True):
        tally.add(GyroSamples(t_s, gyro_dps, t_s, t_s))
    assert tally.longest_run == equal
    verdict = judge_stream(
        tally, NONE, StreamHealth(frames_good=1000), 100.0, StreamLimits(), duration_s=10.0
    )
    assert (verdict is not None and "stuck" in verdict) == stuck


def coarse(level: float, *, pieces: int = 7, stuck: int = 0) -> StreamTally:
    """A minute at a kilohertz of an output whose steps are five times its noise, at a level between two steps."""
    rng = np.random.default_rng(3)
    values = np.round(level + 0.2 * rng.normal(size=60_000))
    values[20_000 : 20_000 + stuck] = 1.0
    tally, t_s = StreamTally(1000.0), np.arange(60_000) / 1000.0
    for part, now_s in zip(np.array_split(values, pieces), np.array_split(t_s, pieces), strict=True):
        tally.add(GyroSamples(now_s, part, now_s, np.zeros(now_s.size)))
    return tally


@pytest.mark.parametrize(("stuck", "verdict"), [(0, False), (2_000, True)])
def test_a_coarse_output_is_not_stuck_where_its_runs_have_all_lengths(stuck: int, verdict: bool) -> None:
    tally = coarse(0.07, stuck=stuck)
    assert tally.longest_run >= 100
    said = judge_stream(
        tally, NONE, StreamHealth(frames_good=60_000), 1000.0, StreamLimits(), duration_s=60.0
    )
    assert (said is not None and "stuck" in said) == verdict


@pytest.mark.parametrize(("after_pause", "restarts"), [(1, 1), (50, 0)])
def test_a_pause_is_a_restart_unless_its_bytes_come_late(after_pause: int, restarts: int) -> None:
    transport = ChunkTransport([])
    clock = Hand()
    spec = StreamSpec("kvh-frame-a on /dev/ttyX", 50.0, 921600, 5.0, (b"R",))
    device = WireGyro(
        spec, lambda: transport, lambda: kvh_frame.KvhFrameDecoder(OPTIONS), clock, threaded=False
    )
    sleeping = clock.sleep

    def sleep_and_send(duration_s: float) -> None:
        sleeping(duration_s)
        device.take(clock.now_s(), frames(1))

    clock.sleep = sleep_and_send  # type: ignore[method-assign]
    device.start()
    for _ in range(99):
        clock.sleep(0.02)
    sleeping(1.0)
    device.take(clock.now_s(), frames(after_pause)[:50])
    device.take(clock.now_s(), frames(after_pause)[50:])
    for _ in range(20):
        clock.sleep(0.02)
    assert device.health().restarts == restarts
    assert transport.written == [b"R"] * (1 + restarts)
    device.close()
    assert transport.closed.is_set()


def test_a_repeated_frame_is_not_a_sample() -> None:
    decoder = kvh_frame.KvhFrameDecoder(OPTIONS)
    one, two = (kvh_frame.encode(1.0, 20.0, i, OPTIONS) for i in (5, 6))
    assert len(decoder.feed(one + one + two + two + two)) == 2
    assert decoder.health().frames_bad == 3
    assert decoder.health().sequence_gaps == 0
