"""How long the commands take: help, the full simulated rd2100 acquire, fit and report on it."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from tests.benchmarks.row import Row, best_time_s


def gyrocal(*arguments: str) -> None:
    """Run the command in a process of its own, as a user does."""
    subprocess.run([sys.executable, "-m", "gyrocal", *arguments], check=True, capture_output=True)


def measure() -> list[Row]:
    """Wall-clock times, start of Python included."""
    rows = [
        Row("gyrocal --help", best_time_s(lambda: gyrocal("--help"), 5), "s", 0.2),
        Row("bare python -c pass, for comparison", best_time_s(_bare_python, 5), "s"),
    ]
    with tempfile.TemporaryDirectory() as directory:
        run, coefficients = Path(directory, "run"), Path(directory, "rd2100.json")
        acquire = ("acquire", "rd2100", "--simulate", "--seed", "1", "--out", str(run))
        rows.append(
            Row("acquire, full simulated rd2100 plan", best_time_s(lambda: gyrocal(*acquire), 1), "s", 30.0)
        )
        fit = ("fit", str(run), "-o", str(coefficients))
        rows.append(Row("fit of that run", best_time_s(lambda: gyrocal(*fit), 1), "s"))
        report = ("report", str(run), "--coefficients", str(coefficients), "--out", f"{directory}/report")
        rows.append(Row("report of that run", best_time_s(lambda: gyrocal(*report), 1), "s", 15.0))
    return rows


def _bare_python() -> None:
    subprocess.run([sys.executable, "-c", "pass"], check=True)
