"""What is known of one unit: figures over its runs, repeatability, limits with guard band, and what was not tested."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gyrocal.calibration.calibrate import Calibration, FitConfig, calibrate
from gyrocal.calibration.figure import Figure
from gyrocal.calibration.figures import common_span, figures_between, merit_figures
from gyrocal.calibration.limits import Limit, Row, judged
from gyrocal.calibration.noise import noise_figures
from gyrocal.calibration.pooled import pooled, repeatability
from gyrocal.calibration.provenance import refuse_twice
from gyrocal.calibration.static import RATE_RAMP, StaticConfig, StaticFigures, examine_static
from gyrocal.calibration.warm_up import NOT_SEEN, WARM_UP
from gyrocal.errors import DataError, ProfileError
from gyrocal.physics.surface import RATE_ORDER
from gyrocal.records.instruments import day_of, expired
from gyrocal.records.run import Run, read_run
from gyrocal.units import DPS_TO_DPH, NORMAL_95, plural

#: Figures whose change from run to run is the unit's repeatability.
_REPEATED = ("bias", "scale_factor_error")
#: What no recording of this bench can say, whatever it holds.
_NEVER_TESTED = (
    "g sensitivity, vibration and shock",
    "magnetic sensitivity",
    "input axis misalignment",
    "bandwidth and latency",
    "ageing over months",
)


@dataclass(frozen=True)
class UnitRun:
    """A run of the unit with its fit, and the head of its run.json (empty for a table)."""

    path: Path
    calibration: Calibration
    head: Mapping[str, Any]


@dataclass(frozen=True)
class RestRun:
    """A run of the unit at rest or over thermal ramps, which carries no surface and tells noise and drift."""

    path: Path
    run: Run
    found: StaticFigures
    head: Mapping[str, Any]


@dataclass(frozen=True)
class Dossier:
    """All that a certificate says.

    Attributes
    ----------
    identity : mapping of str to str
        Unit, who measured, with what.
    not_tested : tuple of str
        Figures without a number and why, and what this bench never tests.
    quality : tuple of str
        What the runs lack.
    expired : tuple of str
        Certificates of instruments that were not valid any more when a run was measured.
    """

    identity: Mapping[str, str]
    simulated: bool
    runs: tuple[UnitRun, ...]
    at_rest: tuple[RestRun, ...]
    rows: tuple[Row, ...]
    not_tested: tuple[str, ...]
    quality: tuple[str, ...]
    expired: tuple[str, ...]

    @property
    def failed(self) -> tuple[Row, ...]:
        """Figures that lie beyond their limits with their whole interval."""
        return tuple(row for row in self.rows if row.judgement == "fail")

    @property
    def undecided(self) -> tuple[Row, ...]:
        """Figures with a limit that the measurement cannot tell."""
        return tuple(row for row in self.rows if row.judgement in ("open", "not tested"))


def unit_run(path: Path, config: FitConfig) -> UnitRun:
    """Fit one run of a unit."""
    found = calibrate(path, config)
    return UnitRun(path, found, {} if found.recording.run is None else _head(path))


def rest_run(path: Path) -> RestRun | None:
    """A run whose data sets are of too few rates for a surface; None of one that is to be fitted."""
    if not path.is_dir():
        return None
    run = read_run(path)
    rates = {r.rate_dps for r in run.segments if r.kind == "rate" and r.outcome != "failed"}
    if len(rates) > RATE_ORDER:
        return None
    return RestRun(path, run, examine_static(StaticConfig(path)), _head(path))


def _head(path: Path) -> dict[str, Any]:
    return dict(json.loads((path / "run.json").read_text(encoding="utf-8")))


def compile_dossier(
    runs: Sequence[UnitRun], limits: Mapping[str, Limit], source: str, at_rest: Sequence[RestRun] = ()
) -> Dossier:
    """Put the runs of one unit together.

    Parameters
    ----------
    source : where the limits come from, for messages
    at_rest : runs that carry no surface

    Raises
    ------
    DataError
        No run that carries a surface, or one given twice. ProfileError: a limit of a figure that
        there is not.
    """
    if not runs:
        raise DataError(
            "No run has rates enough for a surface, and a certificate is of a calibrated gyro: give one that `fit` takes too. What "
            "a gyro at rest says is gyrocal noise."
        )
    every: list[UnitRun | RestRun] = [*runs, *at_rest]
    refuse_twice([run.path for run in every])
    rows = [*_merit_rows(runs), *_noise_rows(runs, at_rest), *_repeatability(runs), *_reach(runs)]
    unknown = sorted(set(limits) - {row.known.name for row in rows})
    if unknown:
        names = ", ".join(row.known.name for row in rows)
        raise ProfileError(f"{source}: there is no figure {unknown[0]}. Known: {names}.")
    found = tuple(judged(row, limits.get(row.known.name)) for row in rows)
    missing = [
        f"{figure.title}{state}: {figure.reason}" for row in found for figure, state in _without_number(row)
    ]
    quality = [f"{run.path.name}: {note}" for run in runs for note in run.calibration.notes]
    quality += [f"{r.path.name}: {note}" for r in at_rest for note in (*r.found.warnings, *r.found.notes)]
    return Dossier(
        _identity(runs),
        any(
            run.head.get("simulated") or run.head.get("bench", {}).get("devices") == "virtual"
            for run in every
        ),
        tuple(runs),
        tuple(at_rest),
        found,
        (*missing, *_NEVER_TESTED),
        tuple(quality),
        _expired(every),
    )


def _expired(runs: Sequence[UnitRun | RestRun]) -> tuple[str, ...]:
    """Each certificate once, with the runs that it came too late for."""
    late: dict[str, list[str]] = {}
    for run in runs:
        if (day := day_of(run.head.get("created_utc"))) is not None:
            for text in expired(run.head.get("identity", {}), day):
                late.setdefault(text, []).append(f"{run.path.name} ({day.isoformat()})")
    return tuple(f"{text}, before the measurement of {', '.join(names)}" for text, names in late.items())


def _without_number(row: Row) -> list[tuple[Figure, str]]:
    """What the row cannot say: of both states if for one reason, else of each."""
    lacking = [
        (figure, state)
        for figure, state in ((row.before, ""), (row.after, ", after compensation"))
        if figure is not None and figure.value is None and figure.high is None
    ]
    same = len(lacking) == 2 and lacking[0][0].reason == lacking[1][0].reason
    return lacking[:1] if same else lacking


def _merit_rows(runs: Sequence[UnitRun]) -> list[Row]:
    """Over what the runs share: a range over 60 °C and one over 40 °C have no mean."""
    pairs = [run.calibration.merit for run in runs]
    if len(runs) > 1:
        span = common_span([run.calibration.fit.sets for run in runs])
        pairs = [merit_figures(run.calibration.fit, _left_out_dps(run.calibration), span) for run in runs]
    return [
        Row(pooled([p[name].before for p in pairs]), pooled([p[name].after for p in pairs]))
        for name in pairs[0]
    ]


def _noise_rows(runs: Sequence[UnitRun], at_rest: Sequence[RestRun]) -> list[Row]:
    """Of all records at rest together: a part that no run resolves by itself may be resolved by all of them."""
    noise = runs[0].calibration.noise
    if len(runs) + len(at_rest) > 1:
        noise = noise_figures(*(run.calibration.recording for run in runs), at_rest=[r.run for r in at_rest])
    return [Row(figure, None) for figure in (*noise.figures.values(), *_courses(at_rest))]


def _courses(at_rest: Sequence[RestRun]) -> list[Figure]:
    """What takes a record at rest of its own: the ramp of the longest, and the warm-up of one from power-on."""
    ramp = Figure(RATE_RAMP, "deg/h/h", "R of the drift R t")
    if not at_rest:
        reason = "it takes a record at rest of its own (static_allan profile)"
        return [replace(ramp, reason=reason), replace(NOT_SEEN, reason=f"{reason}, begun at power-on")]
    longest = max(at_rest, key=lambda r: r.found.noise.record_s)
    begun = [r.found.figures[WARM_UP] for r in at_rest]
    return [longest.found.figures[RATE_RAMP], next((f for f in begun if f.value is not None), begun[0])]


def _repeatability(runs: Sequence[UnitRun]) -> list[Row]:
    fits = [run.calibration.fit for run in runs]
    span = common_span([fit.sets for fit in fits])
    found = [figures_between(fit, span) for fit in fits]
    return [Row(repeatability([figures[name] for figures in found]), None) for name in _REPEATED]


def _reach(runs: Sequence[UnitRun]) -> list[Row]:
    """Largest rate tested, what is left on data left out, and the band of the surface."""
    sets = [run.calibration.fit.sets for run in runs]
    largest = max(float(np.max(np.abs(s.rate_dps))) for s in sets)
    rows = [
        Row(
            Figure(
                "maximum_rate_tested",
                "deg/s",
                "largest rate of the table",
                largest,
                largest,
                largest,
                method="the reference rate",
                sample=f"{len(runs)} {plural(len(runs), '[run|runs]')}",
            ),
            None,
        )
    ]
    newest = runs[-1].calibration
    valid, file = newest.coefficients.valid, newest.coefficients
    rates, temps = np.meshgrid(np.linspace(*valid.rate_dps, 41), np.linspace(*valid.temp_c, 13))
    band = NORMAL_95 * float(np.max(file.sigma_dps(rates.ravel(), temps.ravel()))) * DPS_TO_DPH
    rows.append(
        Row(
            None,
            Figure(
                "prediction_band",
                "deg/h",
                "largest half width (95 %) of the surface inside its range",
                band,
                band,
                band,
                method="covariance of the coefficients",
                sample="the newest run",
            ),
        )
    )
    residual = [_residual(run.calibration) for run in runs]
    rows.append(Row(None, pooled(residual)))
    return rows


def _residual(found: Calibration) -> Figure:
    """Root mean square on stretches of time left out; the interval from their scatter."""
    blank = Figure(
        "residual",
        "deg/h",
        "rms error of data sets that the fit has not seen",
        method="twelfths of the time left out",
        size=True,
    )
    error = _left_out_dps(found)
    if error is None or not np.isfinite(error).all():
        return replace(blank, reason="the record is too small to leave a part of it out")
    squares = np.array([float(np.mean(part**2)) for part in np.array_split(error, 12)])
    mean, half = squares.mean(), float(stats.t.ppf(0.975, 11)) * squares.std(ddof=1) / math.sqrt(12)
    value, low, high = (DPS_TO_DPH * math.sqrt(max(v, 0.0)) for v in (mean, mean - half, mean + half))
    return replace(blank, value=value, low=low, high=high, sample=f"{error.size} data sets")


def _left_out_dps(found: Calibration) -> NDArray[np.float64] | None:
    """Error of each data set with its stretch of time left out of the fit."""
    return next((v.error_dps for v in found.cross_validation if v.left_out == "time"), None)


def _identity(runs: Sequence[UnitRun]) -> dict[str, str]:
    newest = runs[-1]
    sensor, about = newest.calibration.recording.sensor, newest.head.get("identity", {})
    bench = newest.head.get("bench", {})
    entries = {
        "Gyro": sensor.get("model"),
        "Serial number": sensor.get("serial"),
        "Firmware": about.get("firmware"),
        "Operator": about.get("operator"),
        "Laboratory": about.get("laboratory"),
        "Table": bench.get("table"),
        "Table certificate": _due(about, "table"),
        "Chamber": bench.get("chamber"),
        "Thermometer certificate": _due(about, "thermometer"),
        "Measured (UTC)": newest.head.get("created_utc"),
        "Figures over": common_span([run.calibration.fit.sets for run in runs]).said,
    }
    return {name: str(value) if value else "not said" for name, value in entries.items()}


def _due(about: Mapping[str, Any], what: str) -> str | None:
    number, due = about.get(f"{what}_certificate"), about.get(f"{what}_due")
    return f"{number}, due {due}" if number and due else number
