"""The tables of a report: on the page as people read them, in CSV with all their digits and units in the header."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.corrected import Examined, Floats
from gyrocal.calibration.figure import bound_said, interval_said, number, value_said
from gyrocal.calibration.fit import rms
from gyrocal.calibration.noise import NoiseFigures
from gyrocal.calibration.residuals import ScatterByRate
from gyrocal.fusion.coefficients import Coefficients, Noise
from gyrocal.physics.surface import SHAPE
from gyrocal.records.datasets import DataSetTable, format_data_sets
from gyrocal.report.levels import levels
from gyrocal.report.page import Table
from gyrocal.report.scatter import SignedScatter
from gyrocal.units import DPS_TO_DPH, NORMAL_95, decimals

#: What the intervals of the coefficients are, by whether the file states none.
_INTERVALS = {
    False: "Intervals are those of the fit: Student's t with the degrees of freedom that each coefficient has.",
    True: "The file states no intervals; these are ± 1.96 standard errors, too narrow where the scatter was estimated "
    "from few data sets.",
}

#: Columns of the figures of merit in CSV.
_MERIT_COLUMNS = ("figure", "state", "value", "low_95", "high_95", "unit", "reason")

_NOISE_NAMES = {
    "angle_random_walk_deg_per_rt_h": ("Angle random walk", "deg/√h"),
    "bias_instability_deg_per_h": ("Bias instability", "deg/h"),
}


def csv_text(columns: Mapping[str, Sequence[Any] | NDArray[Any]]) -> str:
    """CSV text of equally long columns; numbers with the digits that give the same number back, NaN empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        writer.writerow([_cell(value) for value in row])
    return text.getvalue()


def _cell(value: Any) -> Any:
    if isinstance(value, float | np.floating):
        return "" if not np.isfinite(value) else f"{float(value):.12g}"
    return value


def _less(value: float) -> str:
    """``− value``, without a double sign."""
    return f"{'+' if value < 0 else '−'} {abs(value):.6g}"


#: What a surface goes by, and how the rate follows, by its direction.
_OF = {
    "output": ("gyro", "corrected = gyro − error"),
    "input": ("true rate", "gyro = true rate + error, solved for the true rate"),
}


def coefficient_table(coefficients: Coefficients) -> Table:
    """The twelve coefficients with standard errors and 95 % intervals: those of `fit` where the file has them."""
    value = coefficients.surface.coefficients_dps.ravel()
    sigma = np.sqrt(np.maximum(np.diag(coefficients.covariance_dps2), 0.0))
    i, j = (index.ravel() for index in np.indices(SHAPE))
    stated = coefficients.figures.get("fit", {}).get("half_width_95_dps")
    half = NORMAL_95 * sigma if stated is None else np.asarray(stated, dtype=np.float64).ravel()
    low, high = value - half, value + half
    places = [max(decimals(width), 0) for width in half.tolist()]
    rows = [
        (f"c{a}{b}", f"{v:+.{p}f}", f"{s:.{p}f}", f"{lo:+.{p}f} to {hi:+.{p}f}")
        for a, b, v, s, lo, hi, p in zip(i, j, value, sigma, low, high, places, strict=True)
    ]
    surface = coefficients.surface
    what, corrected = _OF[surface.direction]
    note = (
        f"error = Σ cᵢⱼ uⁱ vʲ, u = ({what} {_less(surface.rate_center_dps)} deg/s) / {surface.rate_scale_dps:.6g} deg/s, "
        f"v = (temperature {_less(surface.temp_center_c)} °C) / {surface.temp_scale_c:.6g} °C; {corrected}. {_INTERVALS[stated is None]}"
    )
    text = csv_text(
        {"i": i, "j": j, "value_dps": value, "std_dps": sigma, "low_95_dps": low, "high_95_dps": high}
    )
    columns = ("Term", "Value, deg/s", "Standard error", "95 % interval")
    return Table("coefficients", "Coefficients", columns, rows, text, note)


def noise_table(noise: Noise) -> Table:
    """Noise figures of the coefficient file with their intervals."""
    rows, names, units, values = [], [], [], []
    for key, (name, unit) in _NOISE_NAMES.items():
        interval = getattr(noise, key)
        if interval is None:
            continue
        value, low, high = interval
        rows.append((name, number(value, 0.5 * (high - low)), interval_said(low, high), unit))
        names.append(key)
        units.append(unit)
        values.append(interval)
    array = np.array(values, dtype=float).reshape(-1, 3)
    text = csv_text({"figure": names, "value": array[:, 0], "low_95": array[:, 1], "high_95": array[:, 2]})
    return Table("noise", "Noise", ("Figure", "Value", "95 % interval", "Unit"), rows, text)


def merit_table(coefficients: Coefficients) -> Table:
    """Figures of merit of the gyro as the coefficient file states them: before compensation, and after it."""
    entries: Mapping[str, Any] = coefficients.figures.get("gyro", {})
    rows, columns = [], {name: [] for name in _MERIT_COLUMNS}  # type: ignore[var-annotated]
    for name, entry in entries.items():
        pair = {"before": _of_old_file(entry)} if "value" in entry else entry
        cells = [_stated(pair[state]) if state in pair else "" for state in ("before", "after")]
        before = pair["before"]
        rows.append((name.replace("_", " "), *cells, before["unit"], before["definition"]))
        for state, figure in pair.items():
            low, high = figure["interval_95"] or (None, figure["at_most"])
            values = (name, state, figure["value"], low, high, figure["unit"], figure["reason"])
            for key, cell in zip(_MERIT_COLUMNS, values, strict=True):
                columns[key].append("" if cell is None else cell)
    note = "Named after IEEE Std 952. After: on data that the fit has not seen."
    heads = ("Figure", "Before", "After", "Unit", "Definition")
    return Table("merit", "Figures of merit", heads, rows, csv_text(columns), note)


def _of_old_file(entry: Mapping[str, Any]) -> dict[str, Any]:
    """A figure of a file from before there were intervals: its standard error, and no after."""
    half = NORMAL_95 * (entry.get("std") or 0.0)
    value = entry["value"]
    shared = {"unit": entry["unit"], "definition": entry["meaning"], "reason": "", "at_most": None}
    return {"value": value, "interval_95": [value - half, value + half], **shared}


def _stated(figure: Mapping[str, Any]) -> str:
    """Value and interval, a bound, or why there is neither."""
    if figure["value"] is not None:
        low, high = figure["interval_95"]
        return value_said(figure["value"], low, high)
    return bound_said(figure["at_most"]) if figure["at_most"] is not None else f"none: {figure['reason']}"


def data_set_table(source: Path, data: Examined) -> Table:
    """The data sets as a table that `fit` and `diagnose` read (formats.md); only in CSV."""
    sets = data.sets

    def known(values: Floats) -> Floats | None:
        return values if np.isfinite(values).all() else None

    table = DataSetTable(
        source,
        sets.rate_dps,
        sets.gyro_dps,
        sets.temp_c,
        known(sets.gyro_std_dps),
        known(sets.n),
        known(sets.t_s),
        known(sets.temp_rate_c_per_min),
    )
    return Table("data_sets", "Data sets", (), (), format_data_sets(table), on_page=False)


def residual_table(data: Examined, reasons: Mapping[int, str]) -> Table:
    """Every data set before and after; only in CSV. `reasons` says, by row, why a data set is marked."""
    sets = data.sets
    text = csv_text(
        {
            "segment": sets.segment,
            "t_s": sets.t_s,
            "rate_dps": sets.rate_dps,
            "gyro_dps": sets.gyro_dps,
            "temp_c": sets.temp_c,
            "error_before_dps": sets.error_dps,
            "residual_dps": data.residual_dps,
            "sigma_dps": data.sigma_dps,
            "outcome": sets.outcome,
            "marked": [reasons.get(row, "") for row in range(len(sets))],
        }
    )
    return Table("residuals", "Residuals", (), (), text, on_page=False)


def marked_table(data: Examined, reasons: Mapping[int, str]) -> Table:
    """Outliers and unsettled data sets with their reasons."""
    sets = data.sets
    marked = sorted(reasons)
    rows = [
        (
            str(sets.segment[r]),
            f"{sets.rate_dps[r]:+.3f}",
            f"{sets.temp_c[r]:.2f}",
            f"{data.residual_dps[r] * DPS_TO_DPH:+.1f}",
            reasons[r],
        )
        for r in marked
    ]
    text = csv_text(
        {
            "segment": sets.segment[marked],
            "rate_dps": sets.rate_dps[marked],
            "temp_c": sets.temp_c[marked],
            "residual_dps": data.residual_dps[marked],
            "reason": [reasons[r] for r in marked],
        }
    )
    columns = ("Data set", "Rate, deg/s", "Temperature, °C", "Residual, deg/h", "Why")
    return Table("outliers", "Outliers and unsettled data sets", columns, rows, text, "Listed, not dropped.")


def level_table(data: Examined, values: Floats, name: str, title: str, unit: str, about: str) -> Table:
    """Error before, as measured, and after in each level of rate or temperature; the page's own is `about` something."""
    found, tight = levels(values, most=64, bins=12)
    before = np.array([rms(data.sets.error_dps[level.rows]) for level in found])
    after = np.array([rms(data.residual_dps[level.rows]) for level in found])
    mean = np.array([data.residual_dps[level.rows].mean() for level in found])
    count = np.array([level.rows.size for level in found])
    centre = np.array([level.value for level in found])
    rows = [
        (
            f"{level.value:+.2f}" if tight else f"{level.low:g} to {level.high:g}",
            str(n),
            f"{b * DPS_TO_DPH:.1f}",
            f"{a * DPS_TO_DPH:.2f}",
            f"{m * DPS_TO_DPH:+.2f}",
        )
        for level, n, b, a, m in zip(found, count, before, after, mean, strict=True)
    ]
    text = csv_text(
        {
            unit: centre,
            "count": count,
            "rms_before_dps": before,
            "rms_after_dps": after,
            "mean_residual_dps": mean,
        }
    )
    columns = (title, "Data sets", "rms as measured, deg/h", "rms after, deg/h", "mean after, deg/h")
    note = f"As measured: nothing is taken off. The error before at the top of the page is about {about}."
    return Table(name, f"Error by {title.split(',')[0].lower()}", columns, rows, text, note)


def scatter_table(signed: SignedScatter, tested: ScatterByRate | None) -> Table:
    """Scatter between data sets by rate; only in CSV, the figure shows it."""
    columns: dict[str, Any] = {
        "rate_dps": signed.rate_dps,
        "count": signed.count,
        "between_dps": signed.between_dps,
        "between_low_95_dps": signed.low_dps,
        "between_high_95_dps": signed.high_dps,
        "expected_dps": signed.expected_dps,
    }
    if tested is not None:
        nearest = np.abs(np.abs(signed.rate_dps)[:, None] - tested.rate_dps).argmin(axis=1)
        columns["ratio_to_neighbours"] = tested.neighbours[nearest]
        columns["p_value"] = tested.p_value[nearest]
    return Table("scatter_by_rate", "Scatter by rate", (), (), csv_text(columns), on_page=False)


def allan_table(noise: NoiseFigures) -> Table:
    """Allan deviation with intervals; only in CSV."""
    columns = {
        "tau_s": [p.tau_s for p in noise.points],
        "adev_dps": [p.adev_dps for p in noise.points],
        "low_95_dps": [p.low_dps for p in noise.points],
        "high_95_dps": [p.high_dps for p in noise.points],
        "degrees_of_freedom": [p.dof for p in noise.points],
    }
    text = csv_text({name: np.concatenate(parts) for name, parts in columns.items()})
    return Table("allan_deviation", "Allan deviation", (), (), text, on_page=False)
