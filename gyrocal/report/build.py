"""`gyrocal report`: a recording and its coefficients to figures, tables and one page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import gyrocal
from gyrocal.calibration.material import Material, Progress
from gyrocal.calibration.residuals import ALARM_RATE
from gyrocal.calibration.summary import ABOUT_LINE, STRUCTURE_WORDS
from gyrocal.report import tables
from gyrocal.report.drawings import DRAWINGS
from gyrocal.report.page import Page, Picture, Table, render_page
from gyrocal.report.scatter import scatter_statements, signed_scatter
from gyrocal.report.style import render
from gyrocal.units import DPS_TO_DPH, p_equals, plural


@dataclass(frozen=True)
class ReportResult:
    """What was written, and the numbers on top of the page."""

    out: Path
    verdict: str
    before_dps: float
    after_dps: float
    data_sets: int
    marked: int
    figures: tuple[str, ...]
    missing: tuple[tuple[str, str], ...]
    remarks: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """For ``--json``."""
        return {
            "page": str(self.out / "report.html"),
            "verdict": self.verdict,
            "error_before_rms_dps": self.before_dps,
            "error_after_rms_dps": self.after_dps,
            "data_sets": self.data_sets,
            "outliers_and_unsettled": self.marked,
            "figures": list(self.figures),
            "not_drawn": dict(self.missing),
            "remarks": list(self.remarks),
        }


def report_files(
    material: Material, out: Path, progress: Progress
) -> tuple[ReportResult, dict[str, bytes | str]]:
    """Draw everything that the recording carries: the result, and name to contents of what goes to `out`."""
    pictures: list[Picture] = []
    files: dict[str, bytes | str] = {}
    for number, drawing in enumerate(DRAWINGS):
        progress(0.3 + 0.65 * number / len(DRAWINGS), drawing.title)
        drawn = drawing.draw(material)
        about = drawing.name, drawing.title, drawing.caption
        if isinstance(drawn, str):
            pictures.append(Picture(*about, missing=drawn))
            continue
        png = render(drawn, "png")
        files |= {f"figures/{drawing.name}.png": png, f"figures/{drawing.name}.svg": render(drawn, "svg")}
        pictures.append(Picture(*about, png))
    page = _page(material, pictures)
    files |= {f"tables/{table.name}.csv": table.csv for table in [*page.lead, *page.tables]}
    files["report.html"] = render_page(page)
    data = material.data
    result = ReportResult(
        out=out,
        verdict=page.verdict,
        before_dps=material.before_dps,
        after_dps=material.after_dps,
        data_sets=len(data.sets),
        marked=int(data.marked.sum()),
        figures=tuple(p.name for p in pictures if p.png),
        missing=tuple((p.name, p.missing) for p in pictures if not p.png),
        remarks=(*page.remarks, *(f"Note: {note}" for note in page.quality)),
    )
    return result, files


def _page(m: Material, pictures: list[Picture]) -> Page:
    before, after = m.before_dps * DPS_TO_DPH, m.after_dps * DPS_TO_DPH
    known = [str(m.coefficients.sensor.get(key) or "") for key in ("model", "serial")]
    sensor = " ".join(word for word in known if word not in ("", "unknown"))
    return Page(
        title=f"Calibration report: {sensor or m.recording.source.name}",
        verdict=_verdict(m, before, after),
        key_figures=_key_figures(m, before, after),
        remarks=_remarks(m),
        pictures=pictures,
        tables=_tables(m),
        lead=[tables.merit_table(m.coefficients)],
        quality=[f"{note.rstrip('.')}." for note in m.notes],
        provenance=_provenance(m),
    )


def _verdict(m: Material, before_dph: float, after_dph: float) -> str:
    whose = "the recording that they were fitted to" if m.own else "a recording that they were not fitted to"
    if "source_sha256" not in m.coefficients.provenance:
        whose = "this recording (whether they were fitted to it, their file does not say)"
    less = before_dph / max(after_dph, 1e-12)
    times = f"{less:.3g} times less" if less >= 1.0 else f"{1.0 / less:.3g} times more: they make it worse"
    return (
        f"These coefficients take the error of {len(m.data.sets)} data sets from {before_dph:.4g} deg/h rms about {_about(m)} to "
        f"{after_dph:.4g} deg/h rms, {times}, on {whose}."
    )


def _about(m: Material) -> str:
    """What is taken off the error before calibration."""
    return "its mean" if m.one_rate else ABOUT_LINE


def _key_figures(m: Material, before_dph: float, after_dph: float) -> list[tuple[str, str]]:
    sets = m.data.sets
    return [
        (f"Error before, rms about {_about(m)}", f"{before_dph:.4g} deg/h"),
        ("Error after, rms", f"{after_dph:.4g} deg/h"),
        ("Factor", f"{before_dph / after_dph:.3g}"),
        ("Data sets", str(len(sets))),
        ("Outliers, unsettled", str(len(m.reasons))),
        ("Rates", f"{sets.rate_dps.min():+.4g} to {sets.rate_dps.max():+.4g} deg/s"),
        ("Temperatures", f"{sets.temp_c.min():.3g} to {sets.temp_c.max():.3g} °C"),
    ]


def _remarks(m: Material) -> list[str]:
    said = scatter_statements(m.tested) if m.tested is not None else []
    said = _structure(m) + said
    if m.noise.points:
        said.append(f"Bias instability is {m.noise.statement}.")
    sets, mask = m.data.sets, m.recording.masked
    flags = int(np.count_nonzero(m.coefficients.flags(sets.gyro_dps, sets.temp_c)))
    if flags:
        lie = plural(flags, "data [set lies|sets lie]")
        said.append(f"{flags} {lie} outside the range of rate or temperature that the coefficients cover.")
    if mask.bad_status or mask.non_finite:
        said.append(
            f"{mask.bad_status} samples of bad status and {mask.non_finite} that are not numbers were left out of the means."
        )
    said += [
        f"Segment {e.segment} ({e.rate_dps:+.4g} deg/s) gives no data set: {e.reason}."
        for e in m.recording.excluded
    ]
    return said


def _structure(m: Material) -> list[str]:
    """What `fit` found in the residual of this very recording."""
    p_values = m.coefficients.figures.get("fit", {}).get("structure_p_values", {})
    if not (m.own and p_values):
        return []
    p_values = {STRUCTURE_WORDS.get(name, name): p for name, p in p_values.items()}
    found = [f"{name} ({p_equals(p)})" for name, p in p_values.items() if p < ALARM_RATE]
    if not found:
        return [f"Over {', '.join(p_values)} the residual holds no structure beyond its noise."]
    return [
        f"The residual is structured in {', '.join(found)}: `gyrocal diagnose` looks for the physics behind it."
    ]


def _tables(m: Material) -> list[Table]:
    data = m.data
    found = [
        tables.coefficient_table(m.coefficients),
        tables.noise_table(m.coefficients.noise),
        tables.marked_table(data, m.reasons),
        tables.level_table(
            data, data.sets.temp_c, "error_by_temperature", "Temperature, °C", "temp_c", _about(m)
        ),
        tables.level_table(data, data.sets.rate_dps, "error_by_rate", "Rate, deg/s", "rate_dps", _about(m)),
        tables.data_set_table(m.recording.source, data),
        tables.residual_table(data, m.reasons),
    ]
    signed = signed_scatter(m.data)
    if signed is not None:
        found.append(tables.scatter_table(signed, m.tested))
    if m.noise.points:
        found.append(tables.allan_table(m.noise))
    return found


def _provenance(m: Material) -> dict[str, str]:
    said = {
        "Recording": m.recording.source.name,
        "Recording sha256": m.recording.sha256,
        "Samples": str(m.recording.n_samples) if m.recording.n_samples else "not known",
        "Drawn by": f"gyrocal {gyrocal.__version__}",
    }
    for key, value in m.coefficients.provenance.items():
        if value not in (None, [], {}):
            said[f"Coefficients: {key.replace('_', ' ')}"] = plain_text(value)
    return said


def plain_text(value: Any) -> str:
    """Say a JSON value without brackets and quotes."""
    if isinstance(value, dict):
        return ", ".join(f"{key.replace('_', ' ')} {plain_text(item)}" for key, item in value.items())
    if isinstance(value, list):
        return ", ".join(map(plain_text, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value)
