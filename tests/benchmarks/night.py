"""A night at the bench: 1,000 frames of 36 bytes a second, `gyrocal acquire --raw` against `gyrocal sim`, in real time.

    python -m tests.benchmarks.night --minutes 480

prints what was lost, memory at begin and end, and the sizes of what was written. The computer may do other work meanwhile.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from gyrocal.bench.capture import decode_capture
from gyrocal.records.run import read_run
from tests.bench.test_resume import toml
from tests.bench.tiny import tiny

#: Length of a data set, and of what lies between two.
_DATA_SET_S, _BETWEEN_S = 60.0, 3.5


def profile_of(minutes: float) -> str:
    """A profile that takes so long, at one temperature."""
    sets = max(2, round(minutes * 60.0 / (_DATA_SET_S + _BETWEEN_S)))
    rates = [round(80.0 * (k + 1) / (sets // 2), 3) for k in range(sets // 2)]
    return toml(
        tiny(
            plan__temperatures_c=[20.0],
            plan__rates_dps=rates,
            plan__dwell_s=_DATA_SET_S,
            sensor__sample_rate_hz=1000.0,
            settle__tolerance_dps=0.5,
            retry__attempts=2,
            retry__then="skip",
            safe__chamber_c=20.0,
            virtual__start_temp_c=20.0,
            virtual__chamber__ripple_c=0.0,
        )
    )


def memory_mib(pid: int) -> float:
    """Resident memory of a process, MiB."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return float(next(line.split()[1] for line in lines if line.startswith("VmRSS"))) / 1024.0


def watched(process: subprocess.Popen[bytes], begin_s: float) -> dict[str, float]:
    """Wait for a process: its memory once it has settled and at its end, and the highest load of the computer."""
    seen: dict[str, float] = {}
    while process.poll() is None:
        time.sleep(2.0)
        try:
            now_mib = memory_mib(process.pid)
        except (OSError, StopIteration):
            break
        if time.monotonic() - begin_s > 60.0:
            seen.setdefault("memory_begin_mib", round(now_mib, 1))
        seen["memory_end_mib"] = round(now_mib, 1)
        seen["load_highest"] = round(max(seen.get("load_highest", 0.0), os.getloadavg()[0]), 1)
    return seen


def lost_frames(run: Path, folder: Path) -> dict[str, Any]:
    """Frames in the capture, and what their counter says was lost before it."""
    decoded = decode_capture(run / "raw" / "gyro-1.raw", folder / "samples.csv")
    lost, last = 0, None
    with (folder / "samples.csv").open() as f:
        next(f)
        for line in f:
            number = int(line.rpartition(",")[2])
            lost += 0 if last is None else (number - last - 1) % 128
            last = number
    return {"frames": decoded.health.frames_good, "damaged": decoded.health.frames_bad, "lost": lost}


def night(minutes: float, folder: Path) -> dict[str, Any]:
    """Serve, acquire, count."""
    (folder / "night.toml").write_text(profile_of(minutes))
    links, run = folder / "ports", folder / "run"
    serve = [
        sys.executable,
        "-u",
        "-m",
        "gyrocal",
        "sim",
        "--profile",
        str(folder / "night.toml"),
        "--links",
        str(links),
    ]
    with subprocess.Popen(serve, stdout=subprocess.PIPE, text=True) as sim:
        stdout = sim.stdout
        if stdout is None:
            raise OSError("the server has no output")
        lines = list(iter(stdout.readline, "# Serving until Ctrl-C.\n"))
        (folder / "wired.toml").write_text((folder / "night.toml").read_text() + "\n" + "".join(lines))
        command = [
            sys.executable,
            "-m",
            "gyrocal",
            "acquire",
            str(folder / "wired.toml"),
            "--raw",
            "--out",
            str(run),
        ]
        begin_s = time.monotonic()
        with subprocess.Popen(command) as acquire:
            seen = watched(acquire, begin_s)
        sim.send_signal(signal.SIGINT)
    taken_s = time.monotonic() - begin_s
    events = [json.loads(line) for line in (run / "journal.jsonl").read_text().splitlines()]
    records = read_run(run).segments
    return {
        "exit_code": acquire.returncode,
        "minutes": round(taken_s / 60.0, 1),
        **lost_frames(run, folder),
        "segments": len(records),
        "failed": sum(record.outcome == "failed" for record in records),
        "done_again": sum(event["event"] == "attempt_failed" for event in events),
        "samples_in_segments": sum(record.n for record in records),
        **seen,
        "journal_bytes": (run / "journal.jsonl").stat().st_size,
        "manifest_bytes": (run / "run.json").stat().st_size,
    }


def main() -> None:
    """Run it and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=480.0)
    minutes = parser.parse_args().minutes
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(night(minutes, Path(folder)), indent=1))


if __name__ == "__main__":
    main()
