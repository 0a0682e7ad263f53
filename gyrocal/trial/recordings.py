"""A made-up recording as files: a table of data sets, or a run directory, as a stranger's logger writes them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrocal.records.csvio import format_columns
from gyrocal.records.datasets import DataSetTable, format_data_sets
from gyrocal.records.files import sha256_of_file, write_atomically
from gyrocal.records.journal import segment_file
from gyrocal.records.run import COLUMNS, SCHEMA
from gyrocal.trial.gyros import Gyro
from gyrocal.trial.plans import GRID_S, Bench

Floats = NDArray[np.float64]

_FORMATS = ("%.3f", "%.7f", "%.4f", "%.0f", "%.6f", "%.5f", "%.3f", "%.3f")
#: So many samples to one reading of table and chamber.
_BENCH_EVERY = 10


def write_table(
    path: Path, bench: Bench, gyro_dps: Floats, temp_c: Floats, spread_dps: Floats | None
) -> Path:
    """Means of data sets; without `spread_dps` neither scatter nor times are told."""
    told = spread_dps is not None
    table = DataSetTable(
        path,
        bench.rate_dps,
        gyro_dps,
        temp_c,
        spread_dps,
        np.full(bench.t_s.size, 16.0) if told else None,
        bench.t_s if told else None,
    )
    write_atomically(path, format_data_sets(table))
    return path


def write_run(path: Path, bench: Bench, gyro: Gyro, gyro_dps: Floats, temp_c: Floats, serial: str) -> Path:
    """A run directory, whose head says what a head says and nothing of what is hidden."""
    (path / "data").mkdir(parents=True)
    frame = bench.frame
    head = {
        "schema": SCHEMA,
        "created_utc": "2026-01-01T00:00:00Z",
        "sensor": {
            "model": gyro.model,
            "serial": serial,
            "rate_range_dps": [-frame.max_rate_dps, frame.max_rate_dps],
            "temp_range_c": [frame.centre_c - frame.half_range_c, frame.centre_c + frame.half_range_c],
            "sample_rate_hz": 10.0,
        },
        "bench": {"table": "made up", "chamber": "made up", "latitude_deg": 42.3},
        "power_on_t_s": 0.0,
    }
    write_atomically(path / "run.json", json.dumps(head, indent=1) + "\n")
    lines = []
    for k, segment in enumerate(bench.segments):
        rows = np.flatnonzero(bench.segment == k)
        file = segment_file(k + 1, segment.kind, segment.rate_dps, segment.chamber_c)
        write_atomically(path / file, _segment_text(bench, rows, gyro_dps[rows], temp_c[rows]))
        line = {
            "event": "segment",
            "id": k + 1,
            "kind": segment.kind,
            "rate_dps": segment.rate_dps,
            "chamber_c": segment.chamber_c,
            "t_start_s": float(bench.t_s[rows[0]]),
            "t_end_s": float(bench.t_s[rows[-1]]),
            "n": int(rows.size),
            "averaging_s": segment.averaging_s,
            "outcome": "ok",
            "file": file,
            "sha256": sha256_of_file(path / file),
        }
        lines.append(json.dumps(line) + "\n")
    write_atomically(path / "journal.jsonl", "".join(lines))
    return path


def _segment_text(bench: Bench, rows: NDArray[np.int64], gyro_dps: Floats, temp_c: Floats) -> str:
    """Samples, and between them readings of the bench, each row with its own time."""
    seen = rows[::_BENCH_EVERY] if bench.is_rate[rows[0]] else rows
    n, m = rows.size, seen.size
    chamber = np.interp(bench.t_s[seen], GRID_S * np.arange(bench.chamber_grid_c.size), bench.chamber_grid_c)
    sample = [bench.t_s[rows], gyro_dps, temp_c, np.zeros(n), *(np.full(n, np.nan) for _ in range(4))]
    reading = [
        bench.t_s[seen] + 0.01,
        *(np.full(m, np.nan) for _ in range(3)),
        bench.rate_dps[seen],
        bench.angle_deg[seen] + 0.01 * bench.rate_dps[seen],
        chamber,
        bench.supply_v[seen],
    ]
    order = np.argsort(np.concatenate([sample[0], reading[0]]), kind="stable")
    columns = {
        name: (np.concatenate([a, b])[order], fmt)
        for name, a, b, fmt in zip(COLUMNS, sample, reading, _FORMATS, strict=True)
    }
    return format_columns(columns)
