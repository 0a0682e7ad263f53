"""A record at rest in a table, sentences and pictures: what `gyrocal noise` prints and writes."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Drawing

import gyrocal
from gyrocal.calibration.course import Course
from gyrocal.calibration.figure import Figure
from gyrocal.calibration.static import StaticFigures
from gyrocal.calibration.summary import said
from gyrocal.report import style
from gyrocal.report.figures_noise import allan_deviation
from gyrocal.report.page import Page, Picture, Table, render_page
from gyrocal.units import DPS_TO_DPH, S_PER_H, plural

#: Neighbouring means of the course that are so many times as far apart as is usual have a gap between them.
_GAP = 3.0


#: What the answer names first, where the record carries it.
_FIRST = ("angle_random_walk", "bias_instability", "mean_bias")


def noise_files(found: StaticFigures) -> dict[str, bytes | str]:
    """Name to contents of what `gyrocal noise --out` writes."""
    course = style.render(course_of(found.course), "png")
    files: dict[str, bytes | str] = {
        "noise.json": json.dumps(found.to_json(), indent=1, sort_keys=True, allow_nan=False) + "\n",
        "course.png": course,
    }
    pictures = [
        Picture("course", "Course of the record", "Output in means, without what is not rest.", course)
    ]
    if found.noise.points:
        curve = allan_deviation(found.noise)
        files["allan_deviation.png"] = drawn = style.render(curve, "png")
        files["allan_deviation.svg"] = style.render(curve, "svg")
        caption = found.noise.fit_statement or found.noise.statement
        pictures.insert(0, Picture("allan", "Allan deviation", f"{caption[:1].upper()}{caption[1:]}.", drawn))
    return files | {"noise.html": render_page(noise_page(found, pictures))}


def noise_page(found: StaticFigures, pictures: list[Picture]) -> Page:
    """The page: what is known of the noise, figures, pictures, and what each figure is or why there is none."""
    columns, rows, title = noise_rows(found)
    every = _figures(found)
    what = [(f.title, f.reason or f.definition, f.method, f.sample) for f in every]
    return Page(
        title=f"A gyro at rest: {found.source.name}",
        verdict=noise_sentence(found),
        key_figures=[(f.title, f"{said(f)} {f.unit}") for f in every if f.name in _FIRST],
        remarks=found.warnings,
        pictures=pictures,
        lead=[Table("figures", title, columns, rows, csv="")],
        tables=[
            Table("what", "What they are", ("figure", "what, or why not", "method", "sample"), what, csv="")
        ],
        quality=found.notes,
        tone="warning" if found.warnings else "plain",
        provenance={"Record": str(found.source), "Software": f"gyrocal {gyrocal.__version__}"},
        beside="noise.json holds everything with all digits.",
    )


def noise_sentence(found: StaticFigures) -> str:
    """The answer in one sentence."""
    every = {f.name: f for f in _figures(found)}
    parts = [
        f"{f.title} {said(f)} {f.unit}" if f.high is not None else f"no {f.title} ({f.reason})"
        for f in (every[name] for name in _FIRST)
    ]
    text = "; ".join(parts)
    return f"{text[:1].upper()}{text[1:]}."


def noise_rows(found: StaticFigures) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...], str]:
    """Columns, rows and title of the table of figures."""
    rows = tuple((f.title, said(f), f.unit) for f in _figures(found))
    title = f"{found.source.name}: {found.samples:,} samples at rest; noise figures from {found.noise.record_s:,.0f} s"
    return ("figure", "value (95 %)", "unit"), rows, title


def _figures(found: StaticFigures) -> tuple[Figure, ...]:
    return (*found.noise.figures.values(), *found.figures.values())


def noise_sentences(found: StaticFigures) -> list[str]:
    """Whether it jumps; how well the model fits; what each figure is, or why there is none; what is missing, and notes."""
    told = list(found.warnings)
    told += [found.noise.fit_statement] if found.noise.fit_statement else []
    by_reason: dict[str, list[str]] = {}
    for f in _figures(found):
        by_reason.setdefault(f.reason or f.definition, []).append(f.title)
    told += [f"{', '.join(titles)}: {reason}" for reason, titles in by_reason.items()]
    if found.missing:
        text = f"{found.missing} [sample is|samples are] missing, bad or not finite, and left out"
        told.append(plural(found.missing, text))
    return told + list(found.notes)


@style.styled
def course_of(course: Course) -> Drawing:
    """Output over the record in means, and the temperature where it is known."""
    figure = style.new_figure(style.TWO_COLUMNS_IN, 3.0)
    axes = figure.add_subplot()
    hours = (course.t_s - course.t_s[0]) / S_PER_H
    # Where the gyro did not stand nothing is known: no line goes across.
    apart = np.diff(hours)
    gaps = np.flatnonzero(apart > _GAP * np.median(apart)) + 1 if apart.size else np.empty(0, dtype=np.int64)
    hours = np.insert(hours, gaps, np.nan)
    drawn: dict[str, Any] = {"linewidth": 0.8, "marker": ".", "markersize": 1.5}
    output_dph = np.insert(course.gyro_dps * DPS_TO_DPH, gaps, np.nan)
    axes.plot(hours, output_dph, color=style.BLUE, label="output", **drawn)
    axes.set_xlabel("Time, h")
    axes.set_ylabel("Output, deg/h", color=style.BLUE)
    axes.tick_params(axis="y", labelcolor=style.BLUE)
    if np.isfinite(course.temp_c).any():
        beside = axes.twinx()
        # A second grid belongs to no line that anybody could tell.
        beside.grid(visible=False)
        temp_c = np.insert(course.temp_c, gaps, np.nan)
        beside.plot(hours, temp_c, color=style.ORANGE, label="temperature", **drawn)
        beside.set_ylabel("Temperature, °C", color=style.ORANGE)
        beside.tick_params(axis="y", labelcolor=style.ORANGE)
    return figure
