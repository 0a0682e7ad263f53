"""Sustained stream: 1,000 Hz of 36-byte frames over a pseudo-terminal, through the driver that ships, to a segment file.

A second process sends, so that the CPU time of this one is the program's own. Lost samples are counted by the frames'
sequence numbers and by their number.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from gyrocal.bench.clock import RealClock
from gyrocal.bench.gyros import kvh_frame
from gyrocal.bench.gyros.stream import StreamSpec, WireGyro
from gyrocal.bench.recorder import Recorder
from gyrocal.bench.transport import SerialTransport
from gyrocal.records.journal import create_run
from tests.benchmarks.row import Row

RATE_HZ = 1000
OPTIONS = kvh_frame.Options(data_rate_hz=RATE_HZ)

SENDER = """
import os, pty, sys, time, tty
from gyrocal.bench.gyros import kvh_frame
options = kvh_frame.Options(data_rate_hz={rate})
frames = [kvh_frame.encode(10.0 + 0.001 * i, 25.0, i, options) for i in range(128)]
master, slave = pty.openpty()
tty.setraw(slave)
print(os.ttyname(slave), flush=True)
sys.stdin.readline()
begin, sent, total = time.monotonic(), 0, int({rate} * {seconds})
while sent < total:
    due = min(int((time.monotonic() - begin) * {rate}), total, sent + 50)
    if due > sent:
        data = b"".join(frames[i % 128] for i in range(sent, due))
        while data:
            data = data[os.write(master, data):]
        sent = due
    time.sleep(0.001)
print(time.monotonic() - begin, flush=True)
sys.stdin.readline()
"""


def stream(seconds: float, folder: Path) -> tuple[int, int, int, float, float]:
    """Record a stream: ``(sent, recorded, gaps and damage, samples a second, CPU s of this process a second)``.

    A sender that has to wait for the reader goes on waiting: then the samples a second fall below their rate.
    """
    code = SENDER.format(rate=RATE_HZ, seconds=seconds)
    total = int(RATE_HZ * seconds)
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as sender:
        stdin, stdout = sender.stdin, sender.stdout
        assert stdin is not None
        assert stdout is not None
        address = stdout.readline().strip()
        clock = RealClock()
        spec = StreamSpec("kvh-frame-a", float(RATE_HZ), 921600, 30.0)
        gyro = WireGyro(
            spec,
            lambda: SerialTransport(address, 921600),
            lambda: kvh_frame.KvhFrameDecoder(OPTIONS),
            clock,
        )
        stdin.write("go\n")
        stdin.flush()
        # `start` waits for the first frame, so the sender has begun when it returns.
        gyro.start()
        head = {"schema": "gyrocal-run/1", "sensor": {"model": "benchmark"}}
        cpu_s = time.process_time()
        with create_run(folder / "run", head) as writer:
            segment = writer.begin_segment(1, "rate", 10.0, 25.0)
            recorder = Recorder(segment, None)
            deadline_s = clock.now_s() + 4 * seconds + 30.0
            while recorder.n < total and clock.now_s() < deadline_s:
                clock.sleep(1.0)
                recorder.add(gyro.drain(), [])
            cpu_s = time.process_time() - cpu_s
            recorder.finish()
            segment.seal(
                t_start_s=recorder.first_t_s,
                t_end_s=recorder.last_t_s,
                n=recorder.n,
                averaging_s=None,
                outcome="ok",
            )
        health = gyro.health()
        gyro.close()
        took_s = float(stdout.readline())
        stdin.write("done\n")
        stdin.flush()
    return total, recorder.n, health.sequence_gaps + health.frames_bad, total / took_s, cpu_s / took_s


def measure(seconds: float = 30.0) -> list[Row]:
    """Loss and CPU share of a sustained stream."""
    with tempfile.TemporaryDirectory() as folder:
        sent, recorded, faults, rate_hz, cpu = stream(seconds, Path(folder))
    return [
        Row(f"samples lost of {sent} (1,000 Hz, 36-byte frames, {seconds:g} s)", sent - recorded, "", 0.0),
        Row("gaps and damaged frames", faults, "", 0.0),
        Row("sustained rate", rate_hz, "Hz", 0.99 * RATE_HZ, at_least=True),
        Row("CPU of one core while streaming to disk", 100.0 * cpu, "%", 25.0),
    ]
