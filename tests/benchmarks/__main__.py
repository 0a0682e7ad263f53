"""``python -m tests.benchmarks [name ...]``: run the benchmarks (all, or those named) and print their numbers."""

from __future__ import annotations

import importlib
import os
import platform
import sys
from pathlib import Path

from tests.benchmarks.row import Row


def main(names: list[str]) -> int:
    """Run ``bench_NAME.py`` for each name, all when there is none; 1 when a goal is missed."""
    found = sorted(p.stem.removeprefix("bench_") for p in Path(__file__).parent.glob("bench_*.py"))
    unknown = sorted(set(names) - set(found))
    if unknown:
        print(f"no benchmark {unknown[0]!r}; there are: {', '.join(found)}", file=sys.stderr)
        return 2
    print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}")
    missed = 0
    for name in names or found:
        rows: list[Row] = importlib.import_module(f"tests.benchmarks.bench_{name}").measure()
        for row in rows:
            goal = ""
            if row.goal is not None:
                goal = f"goal {'>=' if row.at_least else '<='} {row.goal:g}: {'met' if row.met else 'MISSED'}"
                missed += not row.met
            print(f"{row.what:<70} {row.value:>10.4g} {row.unit:<8} {goal}", flush=True)
    return 1 if missed else 0


sys.exit(main(sys.argv[1:]))
