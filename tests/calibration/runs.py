"""Small run directories, written by hand from formats.md: nothing here comes from the package's own writers."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal.calibration.datasets import DataSets

HEADER = "t_s,gyro_dps,gyro_temp_c,status,table_rate_dps,table_angle_deg,chamber_temp_c,supply_v"


@dataclass
class Part:
    """A segment to write: its rows of text, and what the journal says."""

    rows: list[str]
    rate_dps: float = 0.0
    chamber_c: float = 20.0
    kind: str = "rate"
    outcome: str = "ok"
    averaging_s: float | None = 0.1
    extra: dict[str, Any] = field(default_factory=dict)


def gyro_row(t_s: float, gyro_dps: float | str, temp_c: float | str = 20.0, status: int = 0) -> str:
    return f"{t_s:.3f},{gyro_dps},{temp_c},{status},,,,"


def bench_row(t_s: float, rate_dps: float | str, angle_deg: float | str) -> str:
    return f"{t_s:.3f},,,,{rate_dps},{angle_deg},20.0,12.0"


def write_run(path: Path, parts: Sequence[Part], head: dict[str, Any] | None = None) -> Path:
    """Write a run directory; segments get ids from 1 and files by formats.md."""
    (path / "data").mkdir(parents=True)
    body = {"schema": "gyrocal-run/1", "sensor": {"model": "RD2100", "serial": "T1"}, "power_on_t_s": 0.0}
    (path / "run.json").write_text(json.dumps(body | (head or {})))
    lines = []
    for number, part in enumerate(parts, start=1):
        name = f"data/{number:04d}_{part.kind}_{part.rate_dps:+08.3f}dps_{part.chamber_c:+06.1f}C.csv"
        text = "\n".join([HEADER, *part.rows]) + "\n"
        (path / name).write_text(text)
        times = [float(row.split(",")[0]) for row in part.rows] or [0.0]
        event = {
            "event": "segment",
            "id": number,
            "kind": part.kind,
            "rate_dps": part.rate_dps,
            "chamber_c": part.chamber_c,
            "t_start_s": times[0],
            "t_end_s": times[-1],
            "n": len(part.rows),
            "averaging_s": part.averaging_s,
            "outcome": part.outcome,
            "file": name,
            "sha256": hashlib.sha256(text.encode()).hexdigest(),
        }
        lines.append(json.dumps(event | part.extra))
    (path / "journal.jsonl").write_text("\n".join(lines) + "\n")
    return path


def parts_of(sets: DataSets, rng: np.random.Generator, samples: int = 40) -> list[Part]:
    """Segments whose samples average to the simulated data sets."""
    parts = []
    for k in range(len(sets)):
        noise = rng.normal(0.0, sets.gyro_std_dps[k], samples)
        gyro = sets.gyro_dps[k] + noise - noise.mean()
        start = sets.t_s[k] - 0.5 * samples * 0.1
        rows = []
        for i, value in enumerate(gyro):
            t = start + 0.1 * i
            if i % 10 == 0:
                rows.append(bench_row(t, f"{sets.rate_dps[k]:.6f}", f"{sets.rate_dps[k] * (t - start):.5f}"))
            rows.append(gyro_row(t, f"{value:.6f}", f"{sets.temp_c[k]:.3f}"))
        parts.append(Part(rows, float(sets.rate_dps[k]), round(float(sets.temp_c[k]))))
    return parts
