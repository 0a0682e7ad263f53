"""The paper's Table II: error of every run in the four conditions, clockwise and counter-clockwise, with means."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from gyrocal.navigation.replay import LogReplay
from gyrocal.navigation.track import CONDITIONS

#: Blocks of the table, in the paper's order; "mixed" has neither direction.
DIRECTIONS = {"cw": "clockwise", "ccw": "counter-clockwise", "mixed": "turns both ways"}
#: Improvement of each condition over no calibration and no filter: name -> condition (paper: 2-, 7- and 9-fold).
FACTORS = {"filter": "uncalibrated_filter", "calibration": "calibrated", "both": "calibrated_filter"}
#: What a cell of the table is, in words.
MEASURES = {
    "return": "return position error",
    "end": "position error at the end, against truth",
    "none": "no truth of positions and no return to the start: no position error",
}


@dataclass(frozen=True)
class Row:
    """A run, or a mean: error in m by condition id; NaN where a condition is not possible."""

    name: str
    direction: str
    errors_m: Mapping[str, float]


@dataclass(frozen=True)
class Table:
    """Rows in cw and ccw blocks, their means, and the factors by block and over all runs."""

    measure: str
    rows: tuple[Row, ...]
    means: tuple[Row, ...]
    factors: Mapping[str, Mapping[str, float]]
    #: The factors of the rms along the path over all runs; empty where a run has no truth along it.
    rms_factors: Mapping[str, float] = field(default_factory=dict)

    def lines(self) -> list[tuple[str, ...]]:
        """Cells as text, in cm, a mean row after each block; the columns of `HEADINGS`."""
        result = []
        for mean in self.means:
            block = [r for r in self.rows if r.direction == mean.direction]
            result += [_cells(row) for row in block]
            if len(block) > 1:
                result.append(_cells(mean))
        return result

    def to_json(self) -> dict[str, object]:
        """Plain data, m."""
        return {
            "measure": MEASURES[self.measure],
            "unit": "m",
            "rows": [{"run": r.name, "direction": r.direction, **r.errors_m} for r in self.rows],
            "means": [{"direction": r.direction, **r.errors_m} for r in self.means],
            "improvement_factors": {k: dict(v) for k, v in self.factors.items()},
            "improvement_factors_of_rms": dict(self.rms_factors),
        }

    def csv(self) -> str:
        """The table as CSV, m; empty where a condition is not possible."""
        lines = ["run,direction," + ",".join(f"{c.id}_m" for c in CONDITIONS)]
        for row in (*self.rows, *self.means):
            cells = (row.errors_m[c.id] for c in CONDITIONS)
            lines.append(
                f"{row.name},{row.direction}," + ",".join("" if math.isnan(v) else f"{v:.4f}" for v in cells)
            )
        return "\n".join(lines) + "\n"


HEADINGS = ("run", *(f"{c.label}, cm" for c in CONDITIONS))


def make_table(replays: Sequence[LogReplay]) -> Table:
    """Table of replayed logs: return errors where every run has one, else errors at the end."""
    errors = [track.errors for replay in replays for track in replay.tracks]
    if any(e is None for e in errors):
        measure = "none"
    else:
        measure = "return" if all(e and e.return_m is not None for e in errors) else "end"
    rows = tuple(
        Row(replay.name, replay.direction, {c.id: _error(replay, c.id, measure) for c in CONDITIONS})
        for replay in replays
    )
    along = {c.id: _mean_rms_m(replays, c.id) for c in CONDITIONS}
    known = errors and all(e is not None and e.rows for e in errors)
    return replace(table_of(rows, measure), rms_factors=_factors(along) if known else {})


def _mean_rms_m(replays: Sequence[LogReplay], condition_id: str) -> float:
    """Rms position error of a condition, mean over the runs; NaN where it is not possible."""
    tracks = [replay.track(condition_id) for replay in replays]
    return sum(t.errors.rms_m if t and t.errors else math.nan for t in tracks) / len(tracks)


def table_of(rows: Sequence[Row], measure: str) -> Table:
    """Means and factors of ready rows."""
    present = [d for d in DIRECTIONS if any(r.direction == d for r in rows)]
    means = [_mean(rows, d) for d in present]
    if len(present) > 1:
        means.append(_mean(rows, "all"))
    factors = {mean.direction: _factors(mean.errors_m) for mean in means}
    ordered = sorted(rows, key=lambda r: list(DIRECTIONS).index(r.direction))
    return Table(measure, tuple(ordered), tuple(means), factors)


def _factors(errors_m: Mapping[str, float]) -> dict[str, float]:
    return {
        name: _ratio(errors_m["uncalibrated"], errors_m[condition]) for name, condition in FACTORS.items()
    }


def _error(replay: LogReplay, condition_id: str, measure: str) -> float:
    track = replay.track(condition_id)
    if measure == "none" or track is None or track.errors is None:
        return math.nan
    return track.errors.end_m


def _mean(rows: Sequence[Row], direction: str) -> Row:
    block = [r for r in rows if direction in (r.direction, "all")]
    means = {c.id: sum(r.errors_m[c.id] for r in block) / len(block) for c in CONDITIONS}
    return Row(f"mean {direction}", direction, means)


def _ratio(before: float, after: float) -> float:
    return before / after if after > 0 else math.nan


def _cells(row: Row) -> tuple[str, ...]:
    values = (row.errors_m[c.id] for c in CONDITIONS)
    return (row.name, *("-" if math.isnan(v) else f"{100.0 * v:.1f}" for v in values))
