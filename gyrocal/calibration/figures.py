"""Figures of merit of a gyro, named after IEEE Std 952 (fiber-optic gyro test procedures): the one place that makes them.

The error of the data sets is described by the fitted surface and, of what it leaves, a polynomial in the true rate and the
temperature, by generalised least squares under the scatter that the fit has estimated; each figure is a functional of that
description. (The polynomial alone would not do: a gyro whose error is a cubic in its output has none in the true rate, and what
it misses, sixteen times the noise of the virtual RD2100, goes by the weights of the run and not by the gyro.) Its interval
is that of draws of the coefficients: reversed about the estimate, so that what noise adds to a range or a root mean
square is taken off again (Davison and Hinkley, Bootstrap Methods and their Application, 1997, 5.2). The same is done
with the error that is left on data which the fit has not seen: the figure after compensation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.datasets import DataSets
from gyrocal.calibration.figure import Figure
from gyrocal.calibration.fit import SurfaceFit, gls_gain, half_width
from gyrocal.calibration.groups import determined_order, distinct, temperature_groups
from gyrocal.errors import DataError
from gyrocal.physics.surface import SHAPE
from gyrocal.units import DPS_TO_DPH, PPM

Floats = NDArray[np.float64]

_RATES, _TEMPS = 161, 9
_DRAWS = 1500
_SEED = 952
#: Rates below this share of the largest carry no nonlinearity in ppm of the rate: it would be the bias over nothing.
_LEAST_RATE = 0.1
#: A reversal of the rate needs both ways of coming to it at so many data sets.
_LEAST_WAYS = 8

_METHOD = "surface and polynomial in rate and temperature, weighted by the scatter of the data sets; reversed bootstrap"


@dataclass(frozen=True)
class Span:
    """Lowest and highest rate and temperature over which figures are taken."""

    rate_dps: tuple[float, float]
    temp_c: tuple[float, float]

    @property
    def said(self) -> str:
        """Both in words."""
        (low, high), (cold, warm) = self.rate_dps, self.temp_c
        if low > high or cold > warm:
            return _LACKING["overlap"]
        return f"{low:+.4g} to {high:+.4g} deg/s, {cold:.1f} to {warm:.1f} °C"


def common_span(several: Sequence[DataSets]) -> Span:
    """What all of them cover, between which figures of several runs are of the same gyro; a low may lie above its high."""

    def common(of: Sequence[Floats]) -> tuple[float, float]:
        return max(float(x.min()) for x in of), min(float(x.max()) for x in of)

    return Span(common([sets.rate_dps for sets in several]), common([sets.temp_c for sets in several]))


@dataclass(frozen=True)
class Curves:
    """The described error on a grid.

    Attributes
    ----------
    rate_dps, temp_c : ndarray, shapes (r,) and (t,)
    error_dps : ndarray, shape (r, t, draws)
        The first draw is the estimate itself.
    """

    rate_dps: Floats
    temp_c: Floats
    error_dps: Floats

    @property
    def full_dps(self) -> float:
        """The largest rate."""
        return float(np.max(np.abs(self.rate_dps)))

    @property
    def middle(self) -> Floats:
        """Error at the middle temperature, shape (r, draws)."""
        return np.asarray(self.error_dps[:, self.temp_c.size // 2])

    def at_rest(self) -> Floats:
        """Error at zero rate (or the rate nearest to it), shape (t, draws)."""
        return np.asarray(self.error_dps[int(np.argmin(np.abs(self.rate_dps)))])

    def slope(self, rows: NDArray[np.bool_] | None = None) -> Floats:
        """Slope of the error over the rate, by least squares with a free offset, all rates alike, shape (t, draws)."""
        use = np.ones(self.rate_dps.size, dtype=bool) if rows is None else rows
        rate_dps, weight = self.rate_dps[use], _weights(self.rate_dps[use])
        away = rate_dps - np.average(rate_dps, weights=weight)
        return np.asarray(np.einsum("r,rtd->td", weight * away, self.error_dps[use]) / (weight @ away**2))

    def off_line(self) -> Floats:
        """Error less its straight line over the rate, at the middle temperature, shape (r, draws)."""
        line, root = np.vander(self.rate_dps, 2), np.sqrt(_weights(self.rate_dps))[:, None]
        return np.asarray(
            self.middle - line @ np.linalg.lstsq(root * line, root * self.middle, rcond=None)[0]
        )

    def rms(self, values: Floats) -> Floats:
        """Root mean square of (r, draws) over the rates, all alike, shape (draws,)."""
        return np.asarray(np.sqrt(np.average(values**2, axis=0, weights=_weights(self.rate_dps))))

    def temperature_slope(self, values: Floats) -> Floats:
        """Slope of (t, draws) over the temperature, shape (draws,)."""
        v = self.temp_c - self.temp_c.mean()
        return np.asarray(v @ values / (v @ v))


@dataclass(frozen=True)
class Law:
    """How a figure comes from the curves: its unit, definition, what the record must vary, and the functional."""

    unit: str
    definition: str
    needs: frozenset[str]
    of: Callable[[Curves], Floats]


def _law(unit: str, definition: str, needs: str, of: Callable[[Curves], Floats]) -> Law:
    return Law(unit, definition, frozenset(needs.split()), of)


LAWS: Mapping[str, Law] = {
    "scale_factor_error": _law(
        "ppm",
        "least-squares slope of the error over the rate, all rates alike, middle temperature",
        "rate",
        lambda c: _mid(c.slope()) / PPM,
    ),
    "scale_factor_temperature_sensitivity": _law(
        "ppm/°C",
        "slope of that slope over the temperature",
        "rate temperature",
        lambda c: c.temperature_slope(c.slope()) / PPM,
    ),
    "scale_factor_over_temperature": _law(
        "ppm peak to peak",
        "range of that slope over the temperatures",
        "rate temperature",
        lambda c: np.ptp(c.slope(), axis=0) / PPM,
    ),
    "scale_factor_nonlinearity_rms": _law(
        "ppm of full scale",
        "rms of the error less its straight line, middle temperature",
        "rate",
        lambda c: c.rms(c.off_line()) / c.full_dps / PPM,
    ),
    "scale_factor_nonlinearity_max": _law(
        "ppm of full scale",
        "largest error less its straight line, middle temperature",
        "rate",
        lambda c: np.max(np.abs(c.off_line()), axis=0) / c.full_dps / PPM,
    ),
    "scale_factor_nonlinearity_of_rate": _law(
        "ppm of the rate",
        f"largest error less its line, over the rate, above {_LEAST_RATE:.0%} of full scale",
        "rate",
        lambda c: _largest_share(c) / PPM,
    ),
    "scale_factor_asymmetry": _law(
        "ppm",
        "slope for positive less that for negative rates, middle temperature",
        "rate signs",
        lambda c: (_mid(c.slope(c.rate_dps >= 0)) - _mid(c.slope(c.rate_dps <= 0))) / PPM,
    ),
    "bias": _law(
        "deg/h",
        "error at zero rate, middle temperature (earth rate within it)",
        "rest",
        lambda c: DPS_TO_DPH * _mid(c.at_rest()),
    ),
    "bias_temperature_sensitivity": _law(
        "deg/h/°C",
        "slope of the bias over the temperature",
        "rest temperature",
        lambda c: DPS_TO_DPH * c.temperature_slope(c.at_rest()),
    ),
    "bias_over_temperature": _law(
        "deg/h peak to peak",
        "range of the bias over the temperatures",
        "rest temperature",
        lambda c: DPS_TO_DPH * np.ptp(c.at_rest(), axis=0),
    ),
}

_LACKING = {
    "overlap": "the runs have no rates or no temperatures in common",
    "rate": "the recording is at a single rate",
    "signs": "the recording turns one way only",
    "temperature": "the recording is at a single temperature",
    "rest": "zero rate lies outside the recording",
}


def _rate_grid(low_dps: float, high_dps: float) -> Floats:
    """Rates from the lowest to the highest, even on either side of zero, which is one of them if it lies between."""
    if not low_dps < 0.0 < high_dps:
        return np.linspace(low_dps, high_dps, _RATES)
    half = _RATES // 2 + 1
    return np.concatenate([np.linspace(low_dps, 0.0, half), np.linspace(0.0, high_dps, half)[1:]])


def _weights(rate_dps: Floats) -> Floats:
    """Weights of an integral over the rates of such a grid, or of one side of it (Simpson's): a plain sum has too much of the ends, where a cubic is largest."""
    weight, zero = np.zeros(rate_dps.size), int(np.searchsorted(rate_dps, 0.0))
    within = 0 < zero < rate_dps.size - 1
    for side in (slice(0, zero + 1), slice(zero, None)) if within else (slice(None),):
        own = np.ones(rate_dps[side].size)
        own[1:-1:2], own[2:-1:2] = 4.0, 2.0
        weight[side] += own * float(np.ptp(rate_dps[side])) / own.sum()
    return weight


def _mid(values: Floats) -> Floats:
    return np.asarray(values[values.shape[0] // 2])


def _largest_share(c: Curves) -> Floats:
    """Of rates from the least that counts, which itself is seldom on the grid: between its neighbours."""
    off, least = c.off_line(), _LEAST_RATE * c.full_dps
    fast = np.abs(c.rate_dps) > least
    shares = [np.abs(off[fast] / c.rate_dps[fast, None])]
    for edge in (-least, least):
        if c.rate_dps[0] <= edge <= c.rate_dps[-1]:
            above = max(int(np.searchsorted(c.rate_dps, edge)), 1)
            low, high = c.rate_dps[above - 1 : above + 1]
            part = (edge - low) / (high - low)
            shares.append(np.abs((1.0 - part) * off[above - 1] + part * off[above])[None] / least)
    return np.asarray(np.max(np.concatenate(shares), axis=0))


@dataclass(frozen=True)
class BeforeAfter:
    """A figure before compensation, and of what compensation leaves on data that the fit has not seen."""

    before: Figure
    after: Figure


def merit_figures(
    fit: SurfaceFit, left_out_dps: Floats | None, span: Span | None = None
) -> dict[str, BeforeAfter]:
    """Figures of merit before and after compensation.

    Parameters
    ----------
    left_out_dps : ndarray, shape (n,), or None
        Error of each data set with its stretch of time left out of the fit; None where that cannot be had.
    span : Span, optional
        A part of the recording's.
    """
    sample, span = f"{len(fit.sets)} data sets", span or common_span([fit.sets])
    before = error_figures(fit, sample, span)
    if left_out_dps is None or not np.isfinite(left_out_dps).all():
        reason = "the record is too small to leave a part of it out"
        after = {n: replace(f, value=None, low=None, high=None, reason=reason) for n, f in before.items()}
    else:
        after = error_figures(fit, f"{sample}, each left out of the fit in its turn", span, left_out_dps)
    pairs = {name: BeforeAfter(before[name], after[name]) for name in before}
    # What a surface of rate and temperature does not follow is the same before and after it.
    for figure in history_figures(fit, sample, span):
        pairs[figure.name] = BeforeAfter(figure, figure)
    return pairs


def figures_between(fit: SurfaceFit, span: Span) -> dict[str, Figure]:
    """Figures before compensation over a span inside the recording's, as runs that are compared have in common."""
    sample = f"{len(fit.sets)} data sets"
    return error_figures(fit, sample, span) | {f.name: f for f in history_figures(fit, sample, span)}


def error_figures(
    fit: SurfaceFit, sample: str, span: Span, left_out_dps: Floats | None = None
) -> dict[str, Figure]:
    """Figures under the scatter of `fit`: of the gyro's own error, or of the error left on data left out, shape (n,)."""
    there = _varied(fit.sets, span)
    curves = _curves(fit, left_out_dps, span) if "overlap" in there else None
    found = {}
    for name, law in LAWS.items():
        lacking = [_LACKING[what] for what in ("overlap", *sorted(law.needs)) if what not in there]
        if lacking or curves is None:
            found[name] = Figure(name, law.unit, law.definition, reason=lacking[0], sample=sample)
        else:
            found[name] = _figure(name, law, law.of(curves), sample)
    return found


def _varied(sets: DataSets, span: Span) -> frozenset[str]:
    (low, high), (cold, warm) = span.rate_dps, span.temp_c
    there = {
        "overlap": low <= high and cold <= warm,
        "rate": high > low and distinct(sets.rate_dps) > 2,
        "signs": low < 0 < high,
        "temperature": warm - cold > 1.0,
        "rest": low <= 0 <= high,
    }
    return frozenset(name for name, holds in there.items() if holds)


def _curves(fit: SurfaceFit, left_out_dps: Floats | None, span: Span) -> Curves:
    """The description on a grid, with draws of its coefficients under the scatter and its degrees of freedom."""
    sets = fit.sets
    rates = _rate_grid(*span.rate_dps)
    temps = np.linspace(*span.temp_c, _TEMPS)
    orders = _orders(sets)
    design = _columns(sets.rate_dps, sets.temp_c, sets, orders)
    gain = gls_gain(fit.scatter.matrix, design)
    covariance = gain @ fit.scatter.matrix @ gain.T
    rng = np.random.default_rng(_SEED)
    dof = float(np.median(fit.dof[fit.terms]))
    # Of Student's law, whose standard deviation the covariance has, as in `half_width`.
    scale = np.sqrt((dof - 2.0) / rng.chisquare(dof, _DRAWS))
    factor = np.linalg.cholesky(covariance + 1e-15 * np.trace(covariance) * np.eye(len(covariance)))
    draws = (factor @ rng.standard_normal((len(covariance), _DRAWS))) * scale
    grid_rate, grid_temp = (g.ravel() for g in np.meshgrid(rates, temps, indexing="ij"))
    if left_out_dps is None:
        known = _known(fit, np.append(sets.rate_dps, grid_rate), np.append(sets.temp_c, grid_temp))
        rest, known = sets.error_dps - known[: len(sets)], known[len(sets) :]
    else:
        rest, known = left_out_dps, np.zeros(grid_rate.size)
    coefficients = (gain @ rest)[:, None] + np.column_stack([np.zeros(len(covariance)), draws])
    grid = _columns(grid_rate, grid_temp, sets, orders)
    return Curves(rates, temps, (known[:, None] + grid @ coefficients).reshape(_RATES, _TEMPS, -1))


def _known(fit: SurfaceFit, rate_dps: Floats, temp_c: Floats) -> Floats:
    """The surface's error at true rates, or none where one of them has no output: then the polynomial has to do."""
    try:
        return np.asarray(fit.surface.output_dps(rate_dps, temp_c) - rate_dps)
    except DataError:
        return np.zeros(rate_dps.size)


def _orders(sets: DataSets) -> tuple[int, int]:
    """Coefficients over rate and over temperature that the levels visited determine."""
    return min(SHAPE[0], distinct(sets.rate_dps)), 1 + determined_order(sets.temp_c)


def _columns(rate_dps: Floats, temp_c: Floats, sets: DataSets, orders: tuple[int, int]) -> Floats:
    def scaled(values: Floats, of: Floats) -> Floats:
        half = 0.5 * float(np.ptp(of)) or 1.0
        return np.asarray((values - 0.5 * (of.max() + of.min())) / half)

    u = np.polynomial.legendre.legvander(scaled(rate_dps, sets.rate_dps), orders[0] - 1)
    v = np.polynomial.legendre.legvander(scaled(temp_c, sets.temp_c), orders[1] - 1)
    return np.asarray((u[:, :, None] * v[:, None, :]).reshape(u.shape[0], -1))


def _figure(name: str, law: Law, values: Floats, sample: str) -> Figure:
    """Value and interval, reversed about the estimate; a size that noise alone may be is only bounded."""
    size = "peak" in law.unit or "nonlinearity" in name
    blank = Figure(name, law.unit, law.definition, method=_METHOD, sample=sample, size=size)
    estimate, drawn = float(values[0]), values[1:]
    low, high = (2.0 * estimate - float(q) for q in np.percentile(drawn, [97.5, 2.5]))
    if not size:
        return replace(blank, value=estimate, low=low, high=high)
    value = max(2.0 * estimate - float(drawn.mean()), 0.0)
    if low <= 0.0:
        bound = max(high, float(np.percentile(np.abs(drawn - estimate), 95)))
        return replace(
            blank, high=bound, reason=f"not told from noise: less than {bound:.3g} {law.unit} with 95 %"
        )
    return replace(blank, value=value, low=low, high=max(high, value))


def history_figures(fit: SurfaceFit, sample: str, span: Span) -> list[Figure]:
    """What depends on where rate and temperature came from, from the error that the fit leaves."""
    sets, rest_dps = fit.sets, fit.residual_dps
    full = float(np.max(np.abs(span.rate_dps))) or 1.0
    return [
        _beside(
            fit,
            rest_dps,
            0.5 * np.sign(np.diff(sets.rate_dps, prepend=sets.rate_dps[0])),
            Figure(
                "rate_hysteresis",
                "ppm of full scale",
                "error at a rate that was reached from below, less when from above",
                sample=sample,
            ),
            1.0 / (PPM * full),
        ),
        _beside(
            fit,
            rest_dps,
            0.5 * _branch(sets),
            Figure(
                "thermal_hysteresis",
                "deg/h",
                "error at a temperature that was reached from below, less when from above",
                sample=sample,
            ),
            DPS_TO_DPH,
        ),
        _beside(
            fit,
            rest_dps,
            sets.temp_rate_c_per_min,
            Figure(
                "bias_temperature_rate_sensitivity",
                "deg/h per °C/min",
                "slope of the error over the temperature rate",
                sample=sample,
            ),
            DPS_TO_DPH,
        ),
    ]


def _branch(sets: DataSets) -> Floats:
    """Whether the temperature of each data set was reached by heating (1) or cooling (-1)."""
    visit = temperature_groups(sets.temp_c)
    level = np.array([sets.temp_c[visit == k].mean() for k in range(int(visit.max()) + 1)])[visit]
    way, last = np.zeros(len(sets)), 0.0
    for k in range(1, len(sets)):
        last = float(np.sign(level[k] - level[k - 1])) if visit[k] != visit[k - 1] else last
        way[k] = last
    return way


def _beside(fit: SurfaceFit, rest_dps: Floats, column: Floats, blank: Figure, unit: float) -> Figure:
    """Coefficient of a column beside the description, by generalised least squares."""
    sets = fit.sets
    blank = replace(blank, method="a column beside the description, weighted by the scatter of the data sets")
    if not np.isfinite(column).all():
        return replace(blank, reason="the recording does not say it of every data set")
    both = [int(np.count_nonzero(column * sign > 1e-3 * np.max(np.abs(column)))) for sign in (1, -1)]
    if min(both) < _LEAST_WAYS:
        return replace(blank, reason=f"it was not reached both ways by {_LEAST_WAYS} data sets or more")
    orders = _orders(sets)
    design = np.column_stack([_columns(sets.rate_dps, sets.temp_c, sets, orders), column])
    if np.linalg.matrix_rank(design) < design.shape[1]:
        return replace(
            blank, reason="it goes with rate or temperature in this recording and cannot be told from them"
        )
    gain = gls_gain(fit.scatter.matrix, design)[-1]
    value = float(gain @ rest_dps)
    dof = float(np.median(fit.dof[fit.terms]))
    half = float(half_width(0.95, dof) * np.sqrt(gain @ fit.scatter.matrix @ gain))
    return replace(blank, value=unit * value, low=unit * (value - half), high=unit * (value + half))
