"""What is known of one unit: figures over its runs, repeatability, limits with guard band, and what was not tested."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy import stats

from gyrocal.calibration.calibrate import Calibration, FitConfig, calibrate
from gyrocal.calibration.figure import Figure
from gyrocal.calibration.noise import noise_figures
from gyrocal.calibration.provenance import refuse_twice
from gyrocal.errors import DataError, ProfileError
from gyrocal.records.files import reading
from gyrocal.records.instruments import day_of, expired
from gyrocal.units import DPS_TO_DPH, NORMAL_95, plural

#: ``open``: the interval reaches over the limit, so that the measurement cannot tell.
Judgement = Literal["pass", "fail", "open", "not tested"]

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
class Row:
    """A figure of the dossier and its judgement.

    Attributes
    ----------
    before, after : Figure or None
        Before compensation and after it. None where compensation makes no difference, or where the figure is only of
        the compensated gyro.
    """

    before: Figure | None
    after: Figure | None
    judgement: Judgement | None = None
    limit: str = ""

    @property
    def known(self) -> Figure:
        """The figure itself, before compensation where there are two."""
        figure = self.before or self.after
        if figure is None:
            raise ValueError("a row without a figure")
        return figure


@dataclass(frozen=True)
class UnitRun:
    """A run of the unit with its fit, and the head of its run.json (empty for a table)."""

    path: Path
    calibration: Calibration
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


@dataclass(frozen=True)
class Limit:
    """What a figure may be at most (its size), before or after compensation."""

    most: float
    state: Literal["before", "after"] = "before"


def read_limits(path: Path) -> dict[str, Limit]:
    """Read a limits file: ``bias_instability = { most = 3.0 }``, ``bias = { most = 2.0, state = "after" }``.

    Raises
    ------
    InputError, ProfileError
        A file that cannot be read, or an entry that is no limit. Names are checked where the figures are known.
    """
    with reading(path):
        text = path.read_text(encoding="utf-8")
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ProfileError(f"{path}: is not TOML ({error}). Correct that line.") from error
    limits = {}
    for name, entry in raw.items():
        known = isinstance(entry, dict) and set(entry) <= {"most", "state"} and "most" in entry
        good = known and isinstance(entry["most"], int | float) and 0 < entry["most"] < math.inf
        if not good or entry.get("state", "before") not in ("before", "after"):
            raise ProfileError(
                f'{path}: {name} is {entry!r}; wanted is {{ most = NUMBER }} above 0, with state = "before" or "after".'
            )
        limits[name] = Limit(float(entry["most"]), entry.get("state", "before"))
    return limits


def unit_run(path: Path, config: FitConfig) -> UnitRun:
    """Fit one run of a unit."""
    found = calibrate(path, config)
    head: dict[str, Any] = {}
    if found.recording.run is not None:
        head = json.loads((path / "run.json").read_text(encoding="utf-8"))
    return UnitRun(path, found, head)


def compile_dossier(runs: Sequence[UnitRun], limits: Mapping[str, Limit], source: str) -> Dossier:
    """Put the runs of one unit together.

    Parameters
    ----------
    source : where the limits come from, for messages

    Raises
    ------
    DataError
        Runs of different units, or one given twice. ProfileError: a limit of a figure that there is not.
    """
    serials = sorted({str(run.calibration.recording.sensor.get("serial") or "") for run in runs})
    if len(serials) > 1:
        shown = ", ".join(s or "no serial number" for s in serials)
        raise DataError(
            f"The runs are of several units ({shown}): a certificate is of one. Use `fleet` for many."
        )
    refuse_twice([run.path for run in runs])
    rows = [*_merit_rows(runs), *_noise_rows(runs), *_repeatability(runs), *_reach(runs)]
    unknown = sorted(set(limits) - {row.known.name for row in rows})
    if unknown:
        names = ", ".join(row.known.name for row in rows)
        raise ProfileError(f"{source}: there is no figure {unknown[0]}. Known: {names}.")
    judged = tuple(_judged(row, limits.get(row.known.name)) for row in rows)
    missing = [
        f"{figure.title}{state}: {figure.reason}" for row in judged for figure, state in _without_number(row)
    ]
    quality = [f"{run.path.name}: {note}" for run in runs for note in run.calibration.notes]
    return Dossier(
        _identity(runs),
        any(
            run.head.get("simulated") or run.head.get("bench", {}).get("devices") == "virtual" for run in runs
        ),
        tuple(runs),
        judged,
        (*missing, *_NEVER_TESTED),
        tuple(quality),
        _expired(runs),
    )


def _expired(runs: Sequence[UnitRun]) -> tuple[str, ...]:
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


def pooled(figures: Sequence[Figure]) -> Figure:
    """One figure from several runs: their mean; the interval allows for what changes between runs.

    With `n` runs the mean is Student t about the truth with n - 1 degrees of freedom; the error within the runs is
    never counted for less than it is. A figure that some of the runs do not tell from noise is bounded: the mean of those
    that do would be too large.
    """
    known = [f for f in figures if f.interval is not None]
    bounded = [f for f in figures if f.interval is None and f.high is not None]
    if bounded and known:
        most = max(max(abs(f.low or 0.0), abs(f.high or 0.0)) for f in [*known, *bounded])
        reason = f"told from noise in {len(known)} of {len(figures)} runs only"
        return replace(known[0], value=None, low=None, high=most, reason=reason)
    if len(known) < 2:
        return known[0] if known else max(figures, key=lambda f: f.high or 0.0)
    values = np.array([f.value for f in known], dtype=float)
    within = np.array(
        [(f.high - f.low) / (2 * NORMAL_95) for f in known if f.low is not None and f.high is not None]
    )
    n = values.size
    half = max(
        float(stats.t.ppf(0.975, n - 1) * values.std(ddof=1) / math.sqrt(n)),
        float(NORMAL_95 * math.sqrt(np.mean(within**2) / n)),
    )
    mean = float(values.mean())
    return replace(
        known[0], value=mean, low=mean - half, high=mean + half, sample=f"{n} runs, {known[0].sample} each"
    )


def _merit_rows(runs: Sequence[UnitRun]) -> list[Row]:
    pairs = [run.calibration.merit for run in runs]
    return [
        Row(pooled([p[name].before for p in pairs]), pooled([p[name].after for p in pairs]))
        for name in pairs[0]
    ]


def _noise_rows(runs: Sequence[UnitRun]) -> list[Row]:
    """Of all records at rest together: a part that no run resolves by itself may be resolved by all of them."""
    first = runs[0].calibration
    noise = noise_figures(*(run.calibration.recording for run in runs)) if len(runs) > 1 else first.noise
    return [Row(figure, None) for figure in noise.figures.values()]


def _repeatability(runs: Sequence[UnitRun]) -> list[Row]:
    rows = []
    for name in _REPEATED:
        figures = [run.calibration.merit[name].before for run in runs]
        blank = Figure(
            f"{name}_repeatability",
            figures[0].unit,
            f"standard deviation of the {figures[0].title} from run to run",
            method="sample standard deviation; chi-square interval",
            sample=f"{len(runs)} {plural(len(runs), '[run|runs]')}",
        )
        values = np.array([f.value for f in figures if f.value is not None], dtype=float)
        if values.size < 2:
            rows.append(
                Row(
                    replace(blank, reason="it takes two runs or more, better with the power off between"),
                    None,
                )
            )
            continue
        n, s = values.size, float(values.std(ddof=1))
        low, high = (s * math.sqrt((n - 1) / float(stats.chi2.ppf(q, n - 1))) for q in (0.975, 0.025))
        rows.append(Row(replace(blank, value=s, low=low, high=high), None))
    return rows


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
    )
    error = next((v.error_dps for v in found.cross_validation if v.left_out == "time"), None)
    if error is None or not np.isfinite(error).all():
        return replace(blank, reason="the record is too small to leave a part of it out")
    squares = np.array([float(np.mean(part**2)) for part in np.array_split(error, 12)])
    mean, half = squares.mean(), float(stats.t.ppf(0.975, 11)) * squares.std(ddof=1) / math.sqrt(12)
    value, low, high = (DPS_TO_DPH * math.sqrt(max(v, 0.0)) for v in (mean, mean - half, mean + half))
    return replace(blank, value=value, low=low, high=high, sample=f"{error.size} data sets")


def _judged(row: Row, limit: Limit | None) -> Row:
    """Pass where the whole interval is inside the limit, fail where all of it is outside (ISO 14253-1's guard band)."""
    if limit is None:
        return row
    state = row.after if limit.state == "after" else row.before
    figure = state or row.known
    text = f"|x| ≤ {limit.most:g} {figure.unit}" + (f", {limit.state}" if row.before and row.after else "")
    if figure.low is None or figure.high is None or figure.value is None:
        judgement: Judgement = (
            "pass" if figure.high is not None and figure.high <= limit.most else "not tested"
        )
        return replace(row, judgement=judgement, limit=text)
    largest = max(abs(figure.low), abs(figure.high))
    least = 0.0 if figure.low <= 0 <= figure.high else min(abs(figure.low), abs(figure.high))
    judgement = "pass" if largest <= limit.most else "fail" if least > limit.most else "open"
    return replace(row, judgement=judgement, limit=text)


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
    }
    return {name: str(value) if value else "not said" for name, value in entries.items()}


def _due(about: Mapping[str, Any], what: str) -> str | None:
    number, due = about.get(f"{what}_certificate"), about.get(f"{what}_due")
    return f"{number}, due {due}" if number and due else number
