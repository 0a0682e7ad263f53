"""A kilohertz of frames over a pseudo-terminal to disk: no sample lost, however busy this computer is."""

from __future__ import annotations

from pathlib import Path

from tests.benchmarks.bench_stream import stream


def test_no_sample_is_lost(tmp_path: Path) -> None:
    sent, recorded, faults, *_ = stream(3.0, tmp_path)
    assert (recorded, faults) == (sent, 0)
