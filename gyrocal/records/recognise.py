"""What a file is that was given in the place of another: the end of the sentence that says so, and who takes it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

#: JSON beyond this size is none of ours.
_LONGEST_JSON = 1 << 24
_LISTED = 6


@dataclass(frozen=True)
class _Kind:
    """A kind of CSV: column names of which all of one set are there, and `others` beside them at most (empty: any)."""

    signs: tuple[frozenset[str], ...]
    says: str
    others: frozenset[str] = frozenset()


def _kind(says: str, *signs: str, others: str = "") -> _Kind:
    return _Kind(tuple(frozenset(sign.split()) for sign in signs), says, frozenset(others.split()))


_KINDS = (
    _kind(
        "is the log of a drive with one wheel in ticks and the other in metres. Give both in one.",
        "left_m right_ticks",
        "left_ticks right_m",
    ),
    _kind(
        "is the log of a drive: `replay` takes it, and `diagnose` with --robot.",
        "left_m right_m",
        "left_ticks right_ticks",
        "speed_mps gyro_dps",
        "speed_m gyro_dps",
    ),
    _kind(
        "is a table of data sets: `fit` and `report` take it, and `diagnose` without --robot.",
        "rate_dps gyro_dps temp_c",
        "rate_dps gyro_counts temp_c",
    ),
    _kind("holds the return errors of squares: `umbmark` takes it.", "direction x_m y_m"),
    _kind(
        "is a log without the rates of a table: `noise` takes it if the gyro stands, `turn` if it was turned on a mark.",
        "t_s gyro_dps",
        others="temp_c status chamber_temp_c supply_v",
    ),
)


def other_table(header: Sequence[str], required: Sequence[str]) -> str:
    """What a CSV with `header` is, where one with `required` columns is wanted; empty where it is no other kind that is known."""
    there = set(header)
    for kind in _KINDS:
        for sign in kind.signs:
            alone = not kind.others or there <= sign | kind.others
            if sign <= there and alone and not sign <= set(required):
                return kind.says
    return ""


def other_text(path: Path, first_line: str) -> str:
    """What a file is that is no CSV; empty where it may be one."""
    if path.suffix.lower() == ".toml":
        return "is a profile or a robot file (TOML), and a recording or a log is wanted here."
    if not first_line.lstrip().startswith("{"):
        return ""
    schema = ""
    if path.stat().st_size < _LONGEST_JSON:
        try:
            body = json.loads(path.read_text(encoding="utf-8-sig"))
        except (ValueError, RecursionError):
            body = None
        schema = str(body.get("schema", "")) if isinstance(body, dict) else ""
    if schema.startswith("gyrocal-coefficients/"):
        return "is a coefficient file, and a recording is wanted here: coefficients are given with --coefficients."
    return "is JSON, and a recording (a run directory, or a CSV) is wanted here."


def not_a_run(path: Path) -> str:
    """What a file, or a directory without ``run.json``, is, and what of it could have been meant."""
    if not path.is_dir():
        return "is a file, and a run directory is wanted here. Give the directory that `acquire` wrote."
    if (path / "metadata.yaml").exists():
        return (
            "is a ROS bag and no run of the bench: `noise` takes it if the gyro stands, `turn` if it was turned on a mark, `replay` "
            "and `diagnose --robot` if it is a drive."
        )
    inside = sorted(
        entry
        for entry in path.iterdir()
        if (entry / "run.json").exists() or entry.suffix.lower() in (".csv", ".ulg", ".bin")
    )
    if not inside:
        return "is a directory without run.json, so it is no run of the bench. Give the directory that `acquire` wrote."
    names = ", ".join(str(entry) for entry in inside[:_LISTED])
    return f"is a directory without run.json, so it is no run of the bench. Did you mean one of: {names}?"
