"""The reading thread: frames in, three different verdicts, health judged by segment."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from gyrocal.bench.clock import RealClock
from gyrocal.bench.devices import StreamHealth
from gyrocal.bench.gyros import kvh_frame
from gyrocal.bench.gyros.stream import StreamLimits, StreamSpec, WireGyro, judge_stream
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

    def clear_input(self) -> None:
        pass

    def close(self) -> None:
        self.closed.set()


def gyro(transport: ChunkTransport, silence_s: float = 0.15) -> WireGyro:
    spec = StreamSpec("kvh-frame-a on /dev/ttyX", 1000.0, 921600, silence_s, (b"R",))
    return WireGyro(spec, lambda: transport, lambda: kvh_frame.KvhFrameDecoder(OPTIONS), RealClock())


def frames(count: int, *, valid: bool = True) -> bytes:
    return b"".join(kvh_frame.encode(10.0, 25.0, i % 128, OPTIONS, valid=valid) for i in range(count))


def test_samples_come_in_order_with_times_from_arrival() -> None:
    transport = ChunkTransport([frames(5), frames(5)[:50], frames(5)[50:]])
    device = gyro(transport)
    device.start()
    assert transport.empty.wait(2.0)
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
    assert transport.closed.wait(2.0)
    assert device.drain().t_s.size == 3
    with pytest.raises(DeviceError, match="the port is gone"):
        device.drain()
    device.close()


def test_a_silent_gyro_is_told() -> None:
    transport = ChunkTransport([frames(3)])
    device = gyro(transport, silence_s=0.05)
    device.start()
    assert device.drain().t_s.size == 3
    transport.closed.wait(0.2)
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
        (STEADY[:1], StreamHealth(frames_good=1), "only 1 samples came"),
        (
            np.delete(STEADY, slice(100, 200)),
            StreamHealth(frames_good=900),
            "900 samples came where 1000 were due",
        ),
        (STEADY, StreamHealth(frames_good=1000, sequence_gaps=20), "20 gaps in the device's counter"),
    ],
)
def test_a_segment_is_judged(
    t_s: np.ndarray[tuple[int], np.dtype[np.float64]], after: StreamHealth, text: str | None
) -> None:
    verdict = judge_stream(t_s, NONE, after, 100.0, StreamLimits())
    assert (verdict is None) if text is None else (verdict is not None and text in verdict)
