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

from gyrocal.calibration.course import Course
from gyrocal.calibration.figure import Figure
from gyrocal.calibration.fit import gls_gain
from gyrocal.calibration.jumps import jumps_of
from gyrocal.calibration.noise import NoiseFigures, figures_of, noise_at_rest
from gyrocal.calibration.rest_reading import (
    Block,
    Reading,
    curves_of,
    less,
    log_blocks,
    read_rest,
    run_blocks,
    without,
    without_glitches,
)
from gyrocal.calibration.trend import Trend, trend_of
from gyrocal.calibration.warm_up import warm_up
from gyrocal.errors import DataError, InputError
from gyrocal.inference.allan_model import FLICKER
from gyrocal.inference.flicker import TIME_CONSTANTS_S, flicker_correlation
from gyrocal.inference.rounding import mean_error, slope_error
from gyrocal.records.bags import is_bag
from gyrocal.records.gyro_log import ALL_EMPTY, GyroChoice
from gyrocal.records.run import Run, read_run
from gyrocal.records.scale import STUCK
from gyrocal.units import DEG_TO_RAD, DPS_TO_DPH, EARTH_RATE_DPH, NORMAL_95, PPM, S_PER_H, plural

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
#: An output that changes by less than this share of itself is one number, but for rounding.
_SAME = 1e-12
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
    set_aside : int
        Single samples that stand far off all others.
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
    set_aside: int = 0

    def to_json(self) -> dict[str, Any]:
        """Plain data, the Allan curve included."""
        every = {**self.noise.figures, **self.figures}
        return {
            "schema": "gyrocal-noise/1",
            "recording": self.source.name,
            "samples": self.samples,
            "missing_samples": self.missing,
            "samples_set_aside": self.set_aside,
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


def examine_static(
    config: StaticConfig, progress: Callable[[float, str], None] | None = None
) -> StaticFigures:
    """Read a run directory, a CSV log, an autopilot's log or a ROS bag of a gyro that stands, and take its figures.

    Raises
    ------
    InputError
        A bad file.
    DataError
        The run holds nothing at rest, the gyro of the log turns, or its output never changes.
    """
    tell = progress or (lambda share, what: None)
    tell(0.0, "reading")
    notes, aside_s = list[str](), list[float]()
    config, run, blocks = _opened(config, notes)
    reading = read_rest(without_glitches(blocks, aside_s))
    if reading.samples == 0:
        lacks = "holds no samples at rest. Record some with the static_allan profile."
        raise DataError(f"{config.path}: {lacks if run else ALL_EMPTY}")
    course = reading.course.course()
    _refuse_what_never_changes(config.path, reading, course)
    off_dps, coarse = _rounded(reading)
    if run is None:
        _refuse_turns(config.path, course)
        reading, trend = _read_again(config, reading, off_dps, notes)
    else:
        trend = trend_of(course, [], off_dps) if reading.segments == 1 else Trend()
        notes += _within(trend)
    notes += _set_aside(aside_s, run) + _of_one_time(reading)
    tell(0.8, "figures")
    curves = [trend.restored(curve) for curve in curves_of(reading)]
    noise = figures_of(curves) if run is None else noise_at_rest(run)
    covariance = _covariance(course, noise, reading.elapsed_s)
    blank = Figure("", "", "", sample=f"{reading.elapsed_s:.4g} s at rest")
    slopes = _slopes(course, covariance, blank, trend)
    notes += _left_in(course, slopes[-1]) if run is None else []
    figures = [*_mean(course, covariance, off_dps, blank, config), *slopes]
    figures.append(warm_up(course, None if run is None else run.power_on_t_s, blank.sample))
    spans = trend.steps
    if spans and run is None:
        reason = "the output jumps within the record: cut out a rest"
        figures = [replace(f, value=None, low=None, high=None, reason=reason) for f in figures]
    figures.append(_clock(reading, config.rate_hz))
    return StaticFigures(
        config.path,
        noise,
        {f.name: f for f in figures},
        course,
        reading.samples,
        reading.missing,
        tuple([_jumps_said(spans)] * bool(spans and run is None) + coarse),
        tuple(notes),
        len(aside_s),
    )


def _opened(config: StaticConfig, notes: list[str]) -> tuple[StaticConfig, Run | None, Iterator[Block]]:
    """Samples of a run or of a log, with the latitude that a run says."""
    if not config.path.is_dir() or is_bag(config.path):
        return config, None, log_blocks(config.path, config.choice, notes)
    if config.choice != GyroChoice():
        raise InputError(f"{config.path}: is a run of one gyro; leave out axis, instance, topic and columns.")
    run = read_run(config.path)
    if config.latitude_deg is None and isinstance(run.bench.get("latitude_deg"), int | float):
        config = replace(config, latitude_deg=float(run.bench["latitude_deg"]))
    notes += list(run.notes)
    return config, run, run_blocks(run)


def _read_again(
    config: StaticConfig, reading: Reading, off_dps: float, notes: list[str]
) -> tuple[Reading, Trend]:
    """A log without its jumps, less what temperature and time do to it, and what these are; means may be off by `off_dps`."""
    course = reading.course.course()
    spans = jumps_of(course, reading.stepped.step)
    bias = None if spans else _over_temperature(course)

    def again(spans: Sequence[tuple[float, float]], trend: Trend) -> Reading:
        blocks = without_glitches(log_blocks(config.path, config.choice, []), [])
        blocks = without(blocks, spans)
        if bias is not None:
            blocks = less(blocks, lambda block: bias(block.temp_c))
        return read_rest(less(blocks, lambda block: trend.smooth_dps(block.t_s)))

    if spans or bias is not None:
        reading = again(spans, Trend())
    if bias is not None:
        low_c, high_c = np.min(course.temp_c), np.max(course.temp_c)
        notes.append(
            f"what temperature does to the output, a polynomial of order {_TEMPERATURE_ORDER} over {low_c:.1f} to {high_c:.1f} °C, is "
            "taken off before noise is told"
        )
    found = trend_of(reading.course.course(), spans, off_dps)
    if found != Trend():
        spans = sorted([*spans, *found.steps])
        reading = again(spans, found)
        notes += [f"{what} is taken off before noise is told" for what in _said(found)]
    return reading, replace(found, steps=tuple(spans))


def _said(trend: Trend) -> list[str]:
    """What the output does beside noise and steps, in words."""
    said = [f"a straight drift, {trend.drift_dps_per_s * DPS_TO_DPH * S_PER_H:.3g} deg/h/h,"] * bool(
        trend.drift_dps_per_s
    )
    if trend.settling is not None:
        size_dps, constant_s = trend.settling
        size = f"{size_dps * DPS_TO_DPH:.3g} deg/h at the beginning"
        said.append(f"what settles as after power-on ({size}, time constant about {constant_s:.2g} s)")
    return said


def _within(trend: Trend) -> list[str]:
    """What stands in the noise of a run, of which nothing is taken off."""
    said = _said(trend) + [f"a step at {start:.4g} to {end:.4g} s" for start, end in trend.steps]
    return [
        f"{what} is within bias instability and rate random walk, which are less without it" for what in said
    ]


def _of_one_time(reading: Reading) -> list[str]:
    if not reading.same_time:
        return []
    return [
        f"{reading.same_time:,} of {reading.samples:,} samples have the time stamp of the one before, and count as samples of their "
        "own: where a logger wrote samples twice, the shortest averaging times do not show the gyro's noise; repair the log"
    ]


def _set_aside(times_s: list[float], run: Run | None) -> list[str]:
    """Single samples that stand far off, in words."""
    if not times_s:
        return []
    text = f"{len(times_s)} single [sample stands|samples stand] far off all others (the first at {times_s[0]:.6g} s)"
    done = "the noise of a run holds them" if run else "the median of five stands in the place of each"
    return [f"{plural(len(times_s), text)}; {done}"]


def _refuse_turns(path: Path, course: Course) -> None:
    middle_dps = float(np.median(course.gyro_dps))
    off_dps = np.abs(course.gyro_dps - middle_dps)
    share = float(np.sum(course.n[off_dps > _TURNING_DPS]) / np.sum(course.n))
    if share > _TURNING_SHARE or abs(middle_dps) > _LARGEST_BIAS_DPS:
        raise DataError(
            f"{path}: the gyro turns in it, at up to {np.max(np.abs(course.gyro_dps)):.3g} deg/s, and noise is told of one that "
            "stands. Cut out a rest, give the table's rate as rate_dps, or take `turn` for turns on a mark."
        )


def _refuse_what_never_changes(path: Path, reading: Reading, course: Course) -> None:
    """Refuse an output that is one number: what rounding of its sums leaves would be told as noise and as a warm-up."""
    curves = [curve for curve in curves_of(reading) if curve.avar.size]
    same_dps = float(course.gyro_dps[0])
    if curves and max(float(curve.avar.max()) for curve in curves) <= (_SAME * same_dps) ** 2:
        raise DataError(
            f"{path}: the output is {same_dps:g} deg/s in all {reading.samples} samples, and tells of no noise. {STUCK}, in finer "
            "steps if the gyro has them."
        )


def _jumps_said(spans: Sequence[tuple[float, float]]) -> str:
    shown = ", ".join(f"{0.5 * (start + end):.4g} s" for start, end in spans[:4]) + (
        ", ..." if len(spans) > 4 else ""
    )
    length_s = sum(end - start for start, end in spans)
    return f"the output jumps (at {shown}): the gyro was moved, or its bias stepped; noise is told without the {length_s:.3g} s around"


def _rounded(reading: Reading) -> tuple[float, list[str]]:
    """How far rounding may put the mean off, and what to say of it where it may do more than that."""
    curves = curves_of(reading)
    # Halves of stretches scatter by half their Allan variance; all halvings together are the scatter of the samples.
    scatter_dps = float(np.sqrt(0.5 * curves[0].avar.sum())) if curves else 0.0
    few_rows = not any(curve.factor.size for curve in curves)
    if few_rows or not np.isfinite(step_dps := reading.stepped.step):
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


def _over_temperature(course: Course) -> np.polynomial.Polynomial | None:
    """The output of a log over its temperatures; None where they are unknown or vary too little to say."""
    known = bool(np.isfinite(course.temp_c).all()) and course.t_s.size >= _LEAST_MEANS
    if not known or not np.ptp(course.temp_c) > _LEAST_RAMP_C:
        return None
    return np.polynomial.Polynomial.fit(
        course.temp_c, course.gyro_dps, _TEMPERATURE_ORDER, w=np.sqrt(course.n)
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


def _slopes(course: Course, covariance: Floats | None, blank: Figure, trend: Trend) -> list[Figure]:
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
    if trend.settling is not None:
        reason = "the output settles as after power-on, which is neither: cut out what comes later"
        return [replace(ramp, reason=reason), replace(warm, reason=reason)]
    columns = [np.ones(course.t_s.size), course.t_s - course.t_s.mean()]
    known = bool(np.isfinite(course.temp_c).all())
    varied = known and float(np.ptp(course.temp_c)) > _LEAST_SPAN_C
    if varied:
        columns.append(course.temp_c - course.temp_c.mean())
        even = np.polynomial.Polynomial.fit(course.t_s, course.temp_c, 1)
        if float(np.ptp(course.temp_c - even(course.t_s))) < _LEAST_SPAN_C:
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


def _left_in(course: Course, sensitivity: Figure) -> list[str]:
    """That the output of a log follows the temperature where nothing of that is taken off, in words."""
    interval = sensitivity.interval
    if interval is None or interval[1] <= 0.0 <= interval[2] or _over_temperature(course) is not None:
        return []
    return [
        f"the output follows the temperature, by {interval[0]:.3g} deg/h/°C over {np.ptp(course.temp_c):.1f} °C, and nothing of that is taken "
        "off: bias instability, rate random walk and the interval of the mean hold it; keep the temperature steady, or go through more "
        f"than {_LEAST_RAMP_C:g} °C"
    ]


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


def _clock(reading: Reading, rate_hz: float | None) -> Figure:
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
    return _with_interval(blank, error, half, 1.0 / PPM)
