"""A record of a gyro that stands: noise figures, mean with an honest interval, drift, earth rate, clock.

Hours at 1 kHz are read in blocks. What is kept are Allan sums (`inference.allan`) and the course in at most a thousand
means (`course`). The mean and the slopes over time and temperature are weighed under the noise that the Allan
variances show: white, 1/f down to the slowest that the fit allows for, and random walk.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.course import Course, CourseSums
from gyrocal.calibration.figure import Figure
from gyrocal.calibration.fit import gls_gain
from gyrocal.calibration.jumps import jumps_of
from gyrocal.calibration.noise import (
    NoiseFigures,
    add_pieces,
    figures_of,
    gaps,
    noise_at_rest,
)
from gyrocal.calibration.warm_up import warm_up
from gyrocal.errors import DataError, InputError
from gyrocal.inference.allan import AllanCurve, AllanSums
from gyrocal.inference.allan_model import FLICKER
from gyrocal.inference.flicker import TIME_CONSTANTS_S, flicker_correlation
from gyrocal.inference.rounding import StepCounts, mean_error, slope_error
from gyrocal.records.bags import is_bag
from gyrocal.records.gyro_log import ALL_EMPTY, GyroChoice, iterate_gyro_log
from gyrocal.records.run import Run, read_run
from gyrocal.units import DEG_TO_RAD, DPS_TO_DPH, EARTH_RATE_DPH, NORMAL_95, S_PER_H

Floats = NDArray[np.float64]

RATE_RAMP = "rate_ramp"

#: A slope over temperature needs as many degrees.
_LEAST_SPAN_C = 3.0
_LEAST_MEANS = 16
#: A log over as many degrees is a thermal ramp: what they do to the output is taken off before its noise is told. Over
#: fewer a drift of the temperature is as good as one of time, and the noise would lose what is slow in it.
_LEAST_RAMP_C, _TEMPERATURE_ORDER = 10.0, 3
#: No gyro at rest is so far off its own median for so much of the time, nor has it such a bias: it turns.
_TURNING_DPS, _TURNING_SHARE, _LARGEST_BIAS_DPS = 5.0, 0.02, 30.0
_PPM = 1e6
#: Figures of an hour are not told to better than this, so that rounding may do as much unsaid.
_ROUNDED = 0.01


@dataclass(frozen=True)
class StaticConfig:
    """What to examine.

    Attributes
    ----------
    latitude_deg : float, optional
        Of the place; with it the earth rate about the sensing axis is known.
    elevation_deg, azimuth_deg : float
        Of the sensing axis: above the horizon (90: up), and clockwise from north.
    rate_hz : float, optional
        Nominal rate of the logged samples, for the error of the clock.
    choice : GyroChoice
        Which gyro of a log.
    """

    path: Path
    latitude_deg: float | None = None
    elevation_deg: float = 90.0
    azimuth_deg: float = 0.0
    rate_hz: float | None = None
    choice: GyroChoice = field(default_factory=GyroChoice)


@dataclass(frozen=True)
class StaticFigures:
    """What a record at rest says.

    Attributes
    ----------
    noise : NoiseFigures
    figures : dict of str to Figure
        ``mean_bias``, ``bias_without_earth_rate``, ``rate_ramp``, ``bias_temperature_sensitivity``, ``warm_up_time``,
        ``clock_error``.
    course : Course
    samples, missing : int
        Samples used, and samples that were bad, empty, not finite or left out.
    warnings : tuple of str
        That the output jumps, and what was left out for it; that its steps hide its noise.
    """

    source: Path
    noise: NoiseFigures
    figures: dict[str, Figure]
    course: Course
    samples: int
    missing: int
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Plain data, the Allan curve included."""
        every = {**self.noise.figures, **self.figures}
        return {
            "schema": "gyrocal-noise/1",
            "recording": self.source.name,
            "samples": self.samples,
            "missing_samples": self.missing,
            "record_s": self.noise.record_s,
            "figures": {name: figure.to_json() for name, figure in every.items()},
            "fit": self.noise.fit_statement,
            "fit_p_value": None if self.noise.model is None else self.noise.model.p_value,
            "allan": [
                {
                    "dt_s": p.dt_s,
                    "tau_s": p.tau_s.tolist(),
                    "adev_dps": p.adev_dps.tolist(),
                    "low_95_dps": p.low_dps.tolist(),
                    "high_95_dps": p.high_dps.tolist(),
                    "used": p.used.tolist(),
                }
                for p in self.noise.points
            ],
            "warnings": list(self.warnings),
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class _Block:
    """Samples in a row of one segment; NaN output is a missing sample."""

    segment: int
    dt_s: float
    t_s: Floats
    gyro_dps: Floats
    temp_c: Floats


@dataclass
class _Reading:
    """What accumulates while a record is read."""

    sums: dict[float, AllanSums] = field(default_factory=dict)
    course: CourseSums = field(default_factory=CourseSums)
    samples: int = 0
    missing: int = 0
    elapsed_s: float = 0.0
    steps: int = 0
    jitter_s: float = 0.0
    stepped: StepCounts = field(default_factory=StepCounts)


def examine_static(
    config: StaticConfig, progress: Callable[[float, str], None] | None = None
) -> StaticFigures:
    """Read a run directory, a CSV log, an autopilot's log or a ROS bag of a gyro that stands, and take its figures.

    Raises
    ------
    InputError
        A bad file.
    DataError
        The run holds nothing at rest, or the gyro of the log turns.
    """
    tell = progress or (lambda share, what: None)
    tell(0.0, "reading")
    rate_hz, notes = config.rate_hz, list[str]()
    if config.path.is_dir() and not is_bag(config.path):
        if config.choice != GyroChoice():
            raise InputError(
                f"{config.path}: is a run of one gyro; leave out axis, instance, topic and columns."
            )
        run = read_run(config.path)
        blocks = _run_blocks(run)
        if config.latitude_deg is None and isinstance(run.bench.get("latitude_deg"), int | float):
            config = replace(config, latitude_deg=float(run.bench["latitude_deg"]))
        notes += list(run.notes)
    else:
        run, blocks = None, _log_blocks(config, notes)
    reading = _read(blocks)
    if reading.samples == 0:
        lacks = "holds no samples at rest. Record some with the static_allan profile."
        raise DataError(f"{config.path}: {lacks if run else ALL_EMPTY}")
    course, raw = reading.course.course(), reading
    spans = list[tuple[float, float]]()
    if run is None:
        _refuse_turns(config.path, course)
        spans = jumps_of(course, reading.stepped.step)
        reading = _read_again(config, reading, spans, notes)
    tell(0.8, "figures")
    curves = _curves(reading)
    noise = figures_of(curves) if run is None else noise_at_rest(run)
    covariance = _covariance(course, noise, reading.elapsed_s)
    off_dps, coarse = _rounded(raw, curves)
    blank = Figure("", "", "", sample=f"{reading.elapsed_s:.4g} s at rest")
    figures = [*_mean(course, covariance, off_dps, blank, config), *_slopes(course, covariance, blank)]
    figures.append(warm_up(course, None if run is None else run.power_on_t_s, blank.sample))
    if spans:
        reason = "the output jumps within the record: cut out a rest"
        figures = [replace(f, value=None, low=None, high=None, reason=reason) for f in figures]
    figures.append(_clock(reading, rate_hz))
    return StaticFigures(
        config.path,
        noise,
        {f.name: f for f in figures},
        course,
        reading.samples,
        reading.missing,
        tuple([_jumps_said(spans)] * bool(spans) + coarse),
        tuple(notes),
    )


def _read_again(
    config: StaticConfig, reading: _Reading, spans: list[tuple[float, float]], notes: list[str]
) -> _Reading:
    """A log without its jumps, or less what temperature does to it; as it was read where there is neither."""
    if spans:
        return _read(_without(_log_blocks(config, []), spans))
    course = reading.course.course()
    bias = _over_temperature(course)
    if bias is None:
        return reading
    low_c, high_c = np.min(course.temp_c), np.max(course.temp_c)
    notes.append(
        f"what temperature does to the output, a polynomial of order {_TEMPERATURE_ORDER} over {low_c:.1f} to {high_c:.1f} °C, is "
        "taken off before noise is told"
    )
    return _read(_less(_log_blocks(config, []), bias))


def _refuse_turns(path: Path, course: Course) -> None:
    middle_dps = float(np.median(course.gyro_dps))
    off_dps = np.abs(course.gyro_dps - middle_dps)
    share = float(np.sum(course.n[off_dps > _TURNING_DPS]) / np.sum(course.n))
    if share > _TURNING_SHARE or abs(middle_dps) > _LARGEST_BIAS_DPS:
        raise DataError(
            f"{path}: the gyro turns in it, at up to {np.max(np.abs(course.gyro_dps)):.3g} deg/s, and noise is told of one that "
            "stands. Cut out a rest, give the table's rate as rate_dps, or take `turn` for turns on a mark."
        )


def _jumps_said(spans: Sequence[tuple[float, float]]) -> str:
    shown = ", ".join(f"{0.5 * (start + end):.4g} s" for start, end in spans[:4]) + (
        ", ..." if len(spans) > 4 else ""
    )
    length_s = sum(end - start for start, end in spans)
    return f"the output jumps (at {shown}): the gyro was moved, or its bias stepped; noise is told without the {length_s:.3g} s around"


def _rounded(reading: _Reading, curves: Sequence[AllanCurve]) -> tuple[float, list[str]]:
    """How far rounding may put the mean off, and what to say of it where it may do more than that."""
    # Halves of stretches scatter by half their Allan variance; all halvings together are the scatter of the samples.
    scatter_dps = float(np.sqrt(0.5 * curves[0].avar.sum())) if curves else 0.0
    if not np.isfinite(step_dps := reading.stepped.step):
        return 0.0, []
    if reading.stepped.few:
        noise_dps = reading.stepped.least_noise()
        scatter_dps = min(scatter_dps, float(np.hypot(noise_dps, step_dps / np.sqrt(12.0))))
    share = min(slope_error(step_dps, scatter_dps), 1.0)
    said = (
        f"the output comes in steps of {step_dps:.3g} deg/s, over which its noise hardly carries it: the figures are those of the "
        f"rounded output, and the gyro's own may differ from them by {share:.0%} or more; log finer samples"
    )
    return mean_error(step_dps, scatter_dps), [said] if share > _ROUNDED else []


def _without(blocks: Iterator[_Block], spans: Sequence[tuple[float, float]]) -> Iterator[_Block]:
    """The blocks, missing what lies in `spans`."""
    for block in blocks:
        inside = np.zeros(block.t_s.shape, dtype=np.bool_)
        for start, end in spans:
            inside |= (block.t_s >= start) & (block.t_s <= end)
        yield replace(block, gyro_dps=np.where(inside, np.nan, block.gyro_dps))


def _over_temperature(course: Course) -> np.polynomial.Polynomial | None:
    """The output of a log over its temperatures; None where they are unknown or vary too little to say."""
    known = bool(np.isfinite(course.temp_c).all()) and course.t_s.size >= _LEAST_MEANS
    if not known or not np.ptp(course.temp_c) > _LEAST_RAMP_C:
        return None
    return np.polynomial.Polynomial.fit(
        course.temp_c, course.gyro_dps, _TEMPERATURE_ORDER, w=np.sqrt(course.n)
    )


def _less(blocks: Iterator[_Block], bias: np.polynomial.Polynomial) -> Iterator[_Block]:
    """The blocks less what temperature does to the output; a sample without a temperature is missing."""
    for block in blocks:
        yield replace(block, gyro_dps=block.gyro_dps - bias(block.temp_c))


def _run_blocks(run: Run) -> Iterator[_Block]:
    for record in run.segments:
        if record.outcome == "failed" or record.rate_dps != 0.0:
            continue
        dt_s = record.averaging_s
        for block in run.iterate_segment(record):
            if dt_s is None and block.t_s.size > 1:
                dt_s = float(np.median(np.diff(block.t_s)))
            if dt_s is not None:
                gyro_dps = np.where(block.good, block.gyro_dps, np.nan)
                yield _Block(record.id, dt_s, block.t_s, gyro_dps, block.gyro_temp_c)


def _log_blocks(config: StaticConfig, notes: list[str]) -> Iterator[_Block]:
    for block in iterate_gyro_log(config.path, config.choice):
        notes += block.notes
        rate = np.where(np.isfinite(block.rate_dps), block.rate_dps, 0.0)
        yield _Block(block.segment, block.usual_dt_s, block.t_s, block.gyro_dps - rate, block.temp_c)


def _read(blocks: Iterator[_Block]) -> _Reading:
    reading, segment, tail = _Reading(), None, np.empty(0)
    for block in blocks:
        if block.segment != segment:
            for sums in reading.sums.values():
                sums.cut()
            segment, tail = block.segment, np.empty(0)
        good = np.isfinite(block.gyro_dps) & np.isfinite(block.t_s)
        t_s, gyro_dps = block.t_s[good], block.gyro_dps[good]
        reading.missing += int(good.size - t_s.size)
        if t_s.size < 2:
            continue
        reading.samples += t_s.size
        reading.stepped.add(block.segment, gyro_dps, block.dt_s)
        reading.course.add(t_s, gyro_dps, block.temp_c[good])
        cuts, tail = gaps(tail, t_s, block.dt_s)
        _time(reading, t_s, cuts, block.dt_s)
        add_pieces(reading.sums.setdefault(block.dt_s, AllanSums(block.dt_s)), np.split(gyro_dps, cuts))
    return reading


def _curves(reading: _Reading) -> list[AllanCurve]:
    """Allan curves; the sample time of a plain log is its mean one, which jitter of the time stamps does not bend."""
    curves = [reading.sums[dt_s].curve() for dt_s in sorted(reading.sums)]
    if len(curves) == 1 and reading.steps:
        return [replace(curves[0], dt_s=reading.elapsed_s / reading.steps)]
    return curves


def _time(reading: _Reading, t_s: Floats, cuts: NDArray[np.int64], dt_s: float) -> None:
    """Elapsed time and number of steps of gapless stretches, for the clock."""
    for piece in np.split(t_s, cuts):
        if piece.size > 1:
            reading.steps += piece.size - 1
            reading.elapsed_s += float(piece[-1] - piece[0])
            reading.jitter_s = max(
                reading.jitter_s, float(np.std(np.diff(piece))) if piece.size > 2 else dt_s
            )


def _covariance(course: Course, noise: NoiseFigures, elapsed_s: float) -> Floats | None:
    """Of the means of a course, shape (k, k), (deg/s)^2; None without a model of the noise."""
    if noise.model is None or not noise.model.fits:
        return None
    # A part that is not resolved counts with half of what it may be at most.
    white, flat, walk = (p.value if p.low > 0.0 else 0.5 * p.high for p in noise.model.parts[1:])
    if not np.all(np.isfinite([white, flat, walk])):
        return None
    duration_s = course.n / course.n.sum() * elapsed_s
    per_decade = flat / FLICKER * np.log(10.0) / np.pi
    later = course.t_s - course.t_s[0]
    matrix = per_decade * flicker_correlation(course.t_s, duration_s, TIME_CONSTANTS_S)
    matrix += 3.0 * walk * np.minimum(later[:, None], later[None, :])
    matrix[np.diag_indices_from(matrix)] += white / duration_s
    return np.asarray(matrix)


def _mean(
    course: Course, covariance: Floats | None, off_dps: float, blank: Figure, config: StaticConfig
) -> list[Figure]:
    """Mean output, and less the earth rate about the sensing axis; rounding may put it off by `off_dps`."""
    share = course.n / course.n.sum()
    mean_dps = float(share @ course.gyro_dps)
    half = np.nan if covariance is None else float(NORMAL_95 * np.sqrt(share @ covariance @ share)) + off_dps
    mean = replace(
        blank,
        name="mean_bias",
        unit="deg/h",
        definition=f"mean output at rest{_at(course)}, earth rate within it",
        method="mean of all samples; white noise, 1/f and random walk in its interval",
    )
    without = replace(mean, name="bias_without_earth_rate")
    if config.latitude_deg is None:
        reason = "the latitude is not given (--latitude)"
        definition = f"mean output{_at(course)} less the earth rate about the axis"
        return [
            _with_interval(mean, mean_dps, half, DPS_TO_DPH),
            replace(without, definition=definition, reason=reason),
        ]
    earth_dph = earth_rate_dph(config.latitude_deg, config.elevation_deg, config.azimuth_deg)
    without = replace(
        without,
        definition=f"mean output{_at(course)} less the earth rate about the axis, {earth_dph:.4f} deg/h",
    )
    return [
        _with_interval(mean, mean_dps, half, DPS_TO_DPH),
        _with_interval(without, mean_dps - earth_dph / DPS_TO_DPH, half, DPS_TO_DPH),
    ]


def _at(course: Course) -> str:
    """Temperatures that a mean is over: it is of these."""
    if not np.isfinite(course.temp_c).any():
        return ""
    low, high = (f"{t:.1f}" for t in (np.nanmin(course.temp_c), np.nanmax(course.temp_c)))
    return f" at {low} °C" if low == high else f" at {low} to {high} °C"


def earth_rate_dph(latitude_deg: float, elevation_deg: float, azimuth_deg: float) -> float:
    """Earth rate about an axis at an elevation above the horizon and an azimuth clockwise from north, deg/h."""
    latitude, elevation, azimuth = (DEG_TO_RAD * v for v in (latitude_deg, elevation_deg, azimuth_deg))
    north = np.cos(latitude) * np.cos(elevation) * np.cos(azimuth)
    return float(EARTH_RATE_DPH * (north + np.sin(latitude) * np.sin(elevation)))


def _slopes(course: Course, covariance: Floats | None, blank: Figure) -> list[Figure]:
    """Slopes over time and temperature, by generalised least squares, jointly where both vary."""
    blank = replace(blank, method="slope of the means over the record, weighted by the noise")
    ramp = replace(blank, name=RATE_RAMP, unit="deg/h/h", definition="R of the drift R t")
    warm = replace(
        blank,
        name="bias_temperature_sensitivity",
        unit="deg/h/°C",
        definition="slope of the output over the temperature",
    )
    if covariance is None or course.t_s.size < _LEAST_MEANS:
        reason = "the record is too short, or its noise has no model"
        return [replace(ramp, reason=reason), replace(warm, reason=reason)]
    columns = [np.ones(course.t_s.size), course.t_s - course.t_s.mean()]
    known = bool(np.isfinite(course.temp_c).all())
    varied = known and float(np.ptp(course.temp_c)) > _LEAST_SPAN_C
    if varied:
        columns.append(course.temp_c - course.temp_c.mean())
        trend = np.polynomial.Polynomial.fit(course.t_s, course.temp_c, 1)
        if float(np.ptp(course.temp_c - trend(course.t_s))) < _LEAST_SPAN_C:
            reason = "the temperature changes evenly with time, and what either does is not told apart"
            return [replace(ramp, reason=reason), replace(warm, reason=reason)]
    design = np.stack(columns, axis=1)
    gain = gls_gain(covariance, design)
    half = NORMAL_95 * np.sqrt(np.sum(gain * (gain @ covariance), axis=1))
    values = gain @ course.gyro_dps
    ramp = _or_bound(_with_interval(ramp, float(values[1]), float(half[1]), DPS_TO_DPH * S_PER_H))
    if not varied:
        reason = (
            f"the temperature varies by less than {_LEAST_SPAN_C:g} °C"
            if known
            else "the temperature is not known"
        )
        return [ramp, replace(warm, reason=reason)]
    return [ramp, _with_interval(warm, float(values[2]), float(half[2]), DPS_TO_DPH)]


def _with_interval(blank: Figure, value: float, half: float, unit: float) -> Figure:
    """The figure in its unit; without a half width it is refused, since a number without an interval is none."""
    if not np.isfinite(half):
        reason = f"{value * unit:.4g} {blank.unit} without an interval: the noise of the record has no model"
        return replace(blank, reason=reason)
    return replace(blank, value=value * unit, low=(value - half) * unit, high=(value + half) * unit)


def _or_bound(figure: Figure) -> Figure:
    """The figure, or what it is at most where its interval holds zero."""
    if figure.interval is None or not figure.interval[1] < 0.0 < figure.interval[2]:
        return figure
    most = max(-figure.interval[1], figure.interval[2])
    reason = f"not told from noise: within ± {most:.3g} {figure.unit} with 95 %"
    return replace(figure, value=None, low=None, high=most, reason=reason)


def _clock(reading: _Reading, rate_hz: float | None) -> Figure:
    blank = Figure(
        "clock_error",
        "ppm",
        "sample clock over the clock of the time stamps, less one",
        method="samples counted between the time stamps of gapless stretches",
        sample=f"{reading.steps} steps",
    )
    if rate_hz is None:
        return replace(blank, reason="the nominal sample rate is not given (--rate-hz)")
    if len(reading.sums) > 1:
        return replace(blank, reason="the samples are means over several times")
    if not reading.elapsed_s > 0:
        return replace(blank, reason="no two time stamps follow each other")
    error = reading.steps / rate_hz / reading.elapsed_s - 1.0
    half = NORMAL_95 * reading.jitter_s / reading.elapsed_s
    return _with_interval(blank, error, half, _PPM)
