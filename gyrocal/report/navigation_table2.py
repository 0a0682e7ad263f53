"""What `gyrocal simulate table2` writes: Table II, the scatter of its factors, and what each input does to it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import gyrocal
from gyrocal.navigation.montecarlo import (
    WORLDS,
    MonteCarlo,
    World,
)
from gyrocal.navigation.sensitivity import (
    PAPER_CM,
    Sensitivity,
    headings,
)
from gyrocal.navigation.table import HEADINGS, Table
from gyrocal.navigation.track import CONDITIONS
from gyrocal.records.files import write_atomically
from gyrocal.report.navigation_figures import bars_caption, draw_bars
from gyrocal.report.page import Page, Picture, render_page
from gyrocal.report.page import Table as PageTable
from gyrocal.report.style import BLUE, GREY, ORANGE, TWO_COLUMNS_IN, new_figure, render, styled

Floats = NDArray[np.float64]

SCHEMA = "gyrocal-table2/1"
#: Improvement factors of the paper, over the mean of all ten runs.
PAPER_FACTORS = {"filter": 2.0, "calibration": 7.0, "both": 9.0}

_KNOWN_TRACK = replace(World().spread, separation_std=0.005, separation_run_std=0.002)

#: What else could be true of the paper's gyro and robot: name -> the world with that changed.
WHAT_IF: Mapping[str, World] = {
    "data sheet, nonlinearity 0.5 % of full scale": WORLDS["full-scale"],
    "data sheet, nonlinearity 0.5 % of the rate": WORLDS["rate"],
    "what would give the paper's table: nonlinearity and slopes a quarter, wheels known to 0.03 % and their "
    "separation to 0.3 %, slip 0.03, scale changed by 0.08 % after the bench": WORLDS["paper"],
    "nonlinearity a quarter (0.13 % rms)": World(nonlinearity=0.25),
    "nonlinearity a quarter, temperature slopes a quarter": World(nonlinearity=0.25, temperature_slope=0.25),
    "bias instability 7.2 deg/h (Table I: 0.002 deg/s)": World(bias_instability_deg_per_h=7.2),
    "scale factor changes by 0.08 % between bench and drive": World(scale_change_std=0.0008),
    "reported temperature 5 °C off the coil's": World(temp_offset_std_c=5.0),
    "effective wheel separation known to 0.5 %": World(spread=_KNOWN_TRACK),
    "a quarter of nonlinearity and slopes, 5 deg/h, separation known to 0.5 %": World(
        nonlinearity=0.25, temperature_slope=0.25, bias_instability_deg_per_h=5.0, spread=_KNOWN_TRACK
    ),
}


@dataclass(frozen=True)
class Table2Request:
    """What to simulate; see `gyrocal simulate table2 --help`."""

    out: Path
    experiments: int
    what_if: int
    seed: int
    workers: int | None = None
    world: str = "full-scale"


@dataclass(frozen=True)
class Table2Result:
    """Tables and verdict for the terminal, and the summary that is written."""

    tables: Sequence[PageTable]
    verdict: str
    summary: Mapping[str, Any]


@dataclass(frozen=True)
class Simulated:
    """What the experiments gave: one table, all of the chosen world and of the others, what each input does."""

    table: Table
    main: MonteCarlo
    changed: Mapping[str, MonteCarlo]
    parts: Mapping[str, Sequence[Sensitivity]]
    both_cm: float


def write_table2(request: Table2Request, done: Simulated) -> Table2Result:
    """Page, figures, tables and summary in ``request.out``."""
    result = _result(request, done)
    pictures = []
    for picture, figure in _figures(done.table, done.main):
        png = render(figure, "png")
        write_atomically(request.out / f"{picture.name}.png", png)
        write_atomically(request.out / f"{picture.name}.svg", render(figure, "svg"))
        pictures.append(replace(picture, png=png))
    for table in result.tables:
        write_atomically(request.out / f"{table.name}.csv", table.csv)
    text = json.dumps(result.summary, indent=1, allow_nan=False) + "\n"
    write_atomically(request.out / "summary.json", text)
    page = Page(
        "The paper's Table II, simulated",
        result.verdict,
        _key_figures(done.main),
        _remarks(request),
        pictures,
        result.tables,
        {"software": f"gyrocal {gyrocal.__version__}", "seed": str(request.seed)},
    )
    write_atomically(request.out / "table2.html", render_page(page))
    return result


def _name_of(world: str) -> str:
    return next((name for name, other in WHAT_IF.items() if other == WORLDS[world]), world)


def _quantiles(values: Floats) -> tuple[float, float, float]:
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    return float(low), float(middle), float(high)


def _result(request: Table2Request, done: Simulated) -> Table2Result:
    table, main, changed, parts = done.table, done.main, done.changed, done.parts
    factors = {name: _quantiles(values) for name, values in main.factors().items()}
    verdict = (
        f"Over {request.experiments} experiments ({_name_of(request.world)}) the mean return error improves "
        + ", ".join(
            f"{middle:.2g}-fold (5..95 %: {low:.3g}..{high:.3g}; paper: {PAPER_FACTORS[name]:g}) by {name}"
            for name, (low, middle, high) in factors.items()
        )
        + "."
    )
    tables = [
        PageTable(
            "table2",
            "Table II: ten runs of one experiment (return position error)",
            HEADINGS,
            table.lines(),
            table.csv(),
        ),
        _what_if_table({_name_of(request.world): main} | dict(changed)),
        _sensitivity_table(
            "sensitivity", "From one error to centimetres of return error", parts["sensitivity"]
        ),
        _sensitivity_table(
            "coefficients",
            "From one coefficient of the surface to centimetres (units here: its standard error)",
            parts["coefficients"],
            f"All twelve with their covariance: {done.both_cm:.2f} cm rms without the filter.",
        ),
    ]
    summary = {
        "schema": SCHEMA,
        "software": f"gyrocal {gyrocal.__version__}",
        "seed": request.seed,
        "world": _name_of(request.world),
        "experiments": request.experiments,
        "table": table.to_json(),
        "factors": {k: {"p05": v[0], "median": v[1], "p95": v[2]} for k, v in factors.items()},
        "mean_error_m": _errors_json(main),
        "what_if": {name: _errors_json(mc) for name, mc in changed.items()},
        "sensitivity": [_plain(s) for s in (*parts["sensitivity"], *parts["coefficients"])],
        "calibration_error_cm": done.both_cm,
        "paper": {"mean_cm": list(PAPER_CM), "factors": PAPER_FACTORS},
    }
    return Table2Result(tables, f"{verdict} {_explanation(parts['sensitivity'])}", summary)


def _explanation(rows: Sequence[Sensitivity]) -> str:
    """Which inputs the paper's own figures would need, from the sensitivities; no figure of it is written here."""
    by_name = {s.source.split(" (")[0]: s for s in rows}
    bent = by_name["uncalibrated: nonlinearity"]
    bias, scale = by_name["gyro bias that the static mean misses"], by_name["gyro scale factor"]
    return (
        f"The paper's {PAPER_CM[0]:g} cm without calibration need a nonlinearity of {0.1 * bent.for_paper:.2f} % rms of full "
        f"scale where the data sheet allows {0.1 * bent.here:.2g} %; its {PAPER_CM[2]:g} cm with calibration need "
        f"{bias.for_paper:.1f} mdeg/s of bias or {0.1 * scale.for_paper:.2f} % of scale factor that the bench did not see."
    )


def _plain(s: Sensitivity) -> dict[str, Any]:
    figures = {
        "no_filter_cm": s.no_filter_cm,
        "filter_cm": s.filter_cm,
        "here": s.here,
        "for_paper": s.for_paper,
    }
    return {"error": s.source, "unit": s.unit} | {
        k: v if np.isfinite(v) else None for k, v in figures.items()
    }


def _errors_json(mc: MonteCarlo) -> dict[str, Any]:
    result: dict[str, Any] = {"experiments": int(mc.all_m.shape[0])}
    for k, condition in enumerate(CONDITIONS):
        low, middle, high = _quantiles(mc.all_m[:, k])
        result[condition.id] = {"p05": low, "median": middle, "p95": high}
    result["factors"] = {
        k: dict(zip(("p05", "median", "p95"), _quantiles(v), strict=True)) for k, v in mc.factors().items()
    }
    return result


def _what_if_table(runs: Mapping[str, MonteCarlo]) -> PageTable:
    columns = (
        "world",
        *(f"{c.label}, cm" for c in CONDITIONS),
        *(f"factor: {name}" for name in PAPER_FACTORS),
    )
    rows = [
        (
            "the paper",
            *(f"{v:.1f}" for v in PAPER_CM),
            *(f"{v:g}" for v in PAPER_FACTORS.values()),
        )
    ]
    csv = [
        ",".join(
            ["world", "experiments", *(f"{c.id}_cm_{q}" for c in CONDITIONS for q in ("p05", "p50", "p95"))]
        )
    ]
    for name, mc in runs.items():
        errors = [_quantiles(100.0 * mc.all_m[:, k]) for k in range(len(CONDITIONS))]
        factors = [_quantiles(v) for v in mc.factors().values()]
        rows.append((name, *(_span(q) for q in errors), *(_span(q) for q in factors)))
        csv.append(",".join([f'"{name}"', str(mc.all_m.shape[0]), *(f"{v:.4g}" for q in errors for v in q)]))
    counts = [mc.all_m.shape[0] for mc in runs.values()]
    others = f", each other row {counts[1]}" if len(counts) > 1 else ""
    note = f"Median of the mean over ten runs (5 % to 95 % of experiments; the first simulated row has {counts[0]}{others}). Each row changes what it names; the row of what would give the paper's table is found by trial and says what that table hangs on."
    return PageTable(
        "what_if",
        "Which physical input would give the paper's factors",
        columns,
        rows,
        "\n".join(csv) + "\n",
        note,
    )


def _span(quantiles: tuple[float, float, float]) -> str:
    low, middle, high = quantiles
    return f"{middle:.3g} ({low:.3g}..{high:.3g})"


def _sensitivity_table(name: str, title: str, rows: Sequence[Sensitivity], note: str = "") -> PageTable:
    cells = [
        (
            s.source,
            s.unit,
            f"{s.no_filter_cm:.2f}",
            f"{s.filter_cm:.2f}",
            _or_dash(s.here),
            _or_dash(s.for_paper),
        )
        for s in rows
    ]
    csv = "\n".join(",".join(f'"{cell}"' for cell in row) for row in (headings(), *cells)) + "\n"
    return PageTable(name, title, headings(), cells, csv, note)


def _or_dash(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "-"


def _key_figures(main: MonteCarlo) -> list[tuple[str, str]]:
    return [(f"factor: {name}", _span(_quantiles(values))) for name, values in main.factors().items()]


def _remarks(request: Table2Request) -> list[str]:
    return [
        f"Each of the {request.experiments} experiments draws an RD2100 ({_name_of(request.world)}), a robot and a day of 5 to 35 °C, and drives five squares each way.",
        "The gyro is calibrated by simulated data sets of the same unit (21 rates, 7 temperatures, 20 s each, every sample with its noise), without the chamber's ramps and the table's own errors.",
        "All conditions share one robot file; its noise figures are those that the robot was drawn from, and the data sheet's for the gyro.",
    ]


def _figures(table: Table, main: MonteCarlo) -> list[tuple[Picture, Figure]]:
    return [
        (
            Picture(
                "factors",
                "Improvement factors",
                "Distribution over the experiments, each a mean over ten runs; the paper's factors as lines.",
            ),
            draw_factors(main),
        ),
        (
            Picture(
                "table2",
                "Table II of one experiment",
                f"Return position error of every run{bars_caption(table)}.",
            ),
            draw_bars(table),
        ),
    ]


@styled
def draw_factors(main: MonteCarlo) -> Figure:
    """Histograms of the three improvement factors, on logarithmic axes."""
    figure = new_figure(TWO_COLUMNS_IN, 2.4)
    panels = figure.subplots(1, 3)
    for axes, (name, values) in zip(panels, main.factors().items(), strict=True):
        bins = max(6, round(2.0 * values.size ** (1 / 3)))  # Rice's rule
        edges = np.geomspace(values.min() * 0.98, values.max() * 1.02, bins + 1)
        axes.hist(values, bins=edges, color=BLUE)
        axes.axvline(float(np.median(values)), color=GREY, linewidth=1.2, linestyle="--", label="median")
        axes.axvline(PAPER_FACTORS[name], color=ORANGE, linewidth=1.4, label="paper")
        axes.set_xscale("log")
        low, high = 0.7 * min(edges[0], PAPER_FACTORS[name]), 1.4 * max(edges[-1], PAPER_FACTORS[name])
        ticks = [t for t in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500) if low < t < high]
        axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
        axes.minorticks_off()
        axes.set_title(f"by {name}: {_span(_quantiles(values))}", fontsize=7.5)
        axes.set_xlabel("improvement factor")
    panels[0].set_ylabel("experiments")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure
