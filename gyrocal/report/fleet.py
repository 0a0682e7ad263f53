"""`gyrocal fleet`: many units beside each other, as page, JSON, CSV and (with pyarrow) Parquet."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

import gyrocal
from gyrocal.calibration.figure import interval_said, number
from gyrocal.calibration.fleet import ALARM_RATE, LEAST_UNITS, Fleet
from gyrocal.records.files import finite
from gyrocal.records.output import write_directory
from gyrocal.report import style
from gyrocal.report.page import Page, Picture, Table, render_page
from gyrocal.units import p_text, plural

#: Figures a picture shows: those of a gyro, not its coefficients.
_LISTED = 40


def write_fleet(fleet: Fleet, out: Path) -> None:
    """Write a comparison to the new directory `out`.

    Raises
    ------
    OutputError
        It holds files or cannot be written; nothing is left behind then.
    """
    frame = _frame(fleet)
    files: dict[str, bytes | str] = {
        "fleet.json": json.dumps(finite(to_json(fleet)), indent=1) + "\n",
        "fleet.csv": frame.to_csv(index=False),
    }
    png = None
    if not _few(fleet):
        figure = distributions(fleet)
        png = style.render(figure, "png")
        files |= {"distributions.png": png, "distributions.svg": style.render(figure, "svg")}
    parquet = _parquet(frame)
    if parquet is not None:
        files["fleet.parquet"] = parquet
    files["fleet.html"] = render_page(_page(fleet, png))
    write_directory(out, files)


def _few(fleet: Fleet) -> bool:
    """Whether there are too few units to speak of a spread."""
    return len(fleet.units) - len(fleet.failed) < LEAST_UNITS


def to_json(fleet: Fleet) -> dict[str, Any]:
    """``gyrocal-fleet/1``."""
    units = [
        {
            "serial": u.serial,
            "source": u.source,
            "created_utc": u.created_utc,
            "error": u.error or None,
            "figures": {name: {"value": v, "std": s} for name, (v, s) in u.figures.items()},
        }
        for u in fleet.units
    ]
    return {
        "schema": "gyrocal-fleet/1",
        "software": f"gyrocal {gyrocal.__version__}",
        "alarm_rate": ALARM_RATE,
        "units": units,
        "spreads": [vars(spread) for spread in fleet.spreads],
        "outlying": [vars(o) for o in fleet.outlying],
        "drifts": [vars(d) for d in fleet.drifts],
    }


def _frame(fleet: Fleet) -> pd.DataFrame:
    rows = []
    for unit in fleet.units:
        row: dict[str, Any] = {"serial": unit.serial, "source": unit.source, "model": unit.model}
        row |= {"created_utc": unit.created_utc, "error": unit.error}
        for name, (value, std) in unit.figures.items():
            row[name], row[f"{name} std"] = value, std
        rows.append(row)
    return pd.DataFrame(rows)


def _parquet(frame: pd.DataFrame) -> bytes | None:
    """The table as Parquet; None without pyarrow."""
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        return None
    stream = io.BytesIO()
    frame.to_parquet(stream, index=False)
    return stream.getvalue()


def fleet_sentence(fleet: Fleet) -> str:
    """The answer in one sentence."""
    good = len(fleet.units) - len(fleet.failed)
    out = sorted({o.serial for o in fleet.outlying})
    parts = [
        f"{good} of {len(fleet.units)} {plural(len(fleet.units), '[recording is|recordings are]')} fitted"
    ]
    if _few(fleet):
        parts.append(f"who is out of line can be told of {LEAST_UNITS} units or more")
    elif out:
        parts.append(f"out of line: {', '.join(out[:8])}{' and others' if len(out) > 8 else ''}")
    else:
        parts.append(f"no unit is out of line (at a rate of false alarms of {ALARM_RATE:.0%})")
    if fleet.drifts:
        parts.append(f"changing along the serials: {', '.join(d.figure for d in fleet.drifts[:4])}")
    return "; ".join(parts) + "."


@style.styled
def distributions(fleet: Fleet) -> Figure:
    """Each figure over the units: a point a unit, in standard deviations between units about the median."""
    shown = [s for s in fleet.spreads if s.n >= 2 and s.between > 0][:_LISTED]
    figure = style.new_figure(style.TWO_COLUMNS_IN, 0.8 + 0.24 * max(len(shown), 1))
    axes = figure.subplots()
    strange = {(o.figure, o.source) for o in fleet.outlying}
    for k, spread in enumerate(shown):
        units = [u for u in fleet.units if spread.figure in u.figures]
        x = np.array([(u.figures[spread.figure][0] - spread.median) / spread.between for u in units])
        out = np.array([(spread.figure, u.source) in strange for u in units], dtype=bool)
        axes.plot(x[~out], np.full(int((~out).sum()), k), "|", color=style.BLUE, markersize=7)
        axes.plot(x[out], np.full(int(out.sum()), k), "o", color=style.ORANGE, fillstyle="none")
    axes.set_yticks(range(len(shown)), [s.figure.replace("_", " ") for s in shown], fontsize=6)
    axes.invert_yaxis()
    axes.set_xlabel("departure from the median, in standard deviations between units (ringed: out of line)")
    return figure


def _page(fleet: Fleet, png: bytes | None) -> Page:
    picture = Picture(
        "distributions",
        "Figures over the units",
        "A tick is a unit. Ringed: out of line by Rosner's test, "
        f"with {ALARM_RATE:.0%} false alarms over all figures of a fleet that has none.",
        png,
        "" if png else f"A spread takes {LEAST_UNITS} units or more.",
    )
    model = next((u.model for u in fleet.units if u.model), "")
    return Page(
        title=f"{len(fleet.units)} {plural(len(fleet.units), '[unit|units]')}{' of ' + model if model else ''}",
        verdict=fleet_sentence(fleet),
        key_figures=[
            ("Units", str(len(fleet.units))),
            ("Not fitted", str(len(fleet.failed))),
            ("Out of line", str(len({o.serial for o in fleet.outlying}))),
        ],
        remarks=[f"{u.source}: {u.error}" for u in fleet.failed],
        pictures=[picture],
        tables=tables(fleet),
        provenance={"Software": f"gyrocal {gyrocal.__version__}"},
        beside="fleet.csv (and fleet.parquet where pyarrow is installed) hold every figure of every unit.",
    )


def tables(fleet: Fleet) -> list[Table]:
    """Spread of each figure, units out of line, drifts along the serials."""
    spread = [
        (_words(s.figure), str(s.n), *map(_cell, (s.median, s.low, s.high, s.between, s.within)))
        for s in fleet.spreads
    ]
    out = [
        (o.serial, _words(o.figure), _cell(o.value), f"{o.deviations:+.1f}", p_text(o.p_value))
        for o in fleet.outlying
    ]
    drift = [
        (_words(d.figure), _cell(d.per_unit), interval_said(d.low, d.high), p_text(d.p_value))
        for d in fleet.drifts
    ]
    columns = ("figure", "units", "median", "least", "largest", "between units", "within a unit")
    return [
        _table(
            "outlying", "Out of line", ("serial", "figure", "value", "deviations of the others", "p"), out
        ),
        _table("drifts", "Change along the serials", ("figure", "per unit", "95 %", "p"), drift),
        _table("spreads", "Spread", columns, spread),
    ]


def _words(figure: str) -> str:
    return figure.replace("_", " ")


def _cell(value: float) -> str:
    """A number, or a dash where none is known."""
    return number(value) if math.isfinite(value) else "-"


def _table(name: str, title: str, columns: Sequence[str], rows: Sequence[tuple[str, ...]]) -> Table:
    csv = "\n".join(",".join(f'"{cell}"' for cell in row) for row in (columns, *rows)) + "\n"
    return Table(name, title, columns, rows, csv)
