"""Parameters of what was named, with intervals: amplitudes beside everything else, shapes by their profile."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from gyrocal.diagnosis.intervals import Profile, amplitude_interval, profile_interval
from gyrocal.diagnosis.laws import Laws
from gyrocal.diagnosis.layers import Fitted, Law
from gyrocal.diagnosis.result import Estimate
from gyrocal.diagnosis.within import Pattern
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.effect import PPM, Effect
from gyrocal.units import NORMAL_95

Floats = NDArray[np.float64]

#: Shapes are profiled within this ratio of the best.
_REACH = 9.0


def normal(value: float, std: float, unit: str) -> Estimate:
    """A normal estimate."""
    return Estimate(value, std, unit, (value - NORMAL_95 * std, value + NORMAL_95 * std))


def of_law(fitted: Fitted, law: Law, laws: Laws, without: list[str]) -> dict[str, Estimate]:
    """Parameters of a law beside everything else in a model.

    Parameters
    ----------
    without : components that the law takes the place of
    """
    effect = CATALOGUE[law.effect]
    model = fitted.model.without(without)
    others = [c for c in model.all if c.name != law.name]
    score, p = fitted.contrasts.precision(others, fitted.fit.log_variance)

    def at(columns: Floats) -> tuple[float, float, float]:
        """Residual sum of squares less a constant, amplitude and its standard deviation."""
        information = columns.T @ p @ columns
        covariance = np.linalg.pinv(information, rcond=1e-12, hermitian=True)
        b = covariance @ (columns.T @ score)
        size = float(np.hypot(*b)) if b.size == 2 else float(b[0])
        along = b / size if b.size == 2 else np.ones(1)
        return (
            -float(columns.T @ score @ b),
            size,
            float(np.sqrt(max(float(along @ covariance @ along), 0.0))),
        )

    _, amplitude, std = at(law.columns)
    profiles = {
        name: _profile(law, name, effect, laws, at)
        for name in effect.search.refined
        if law.shape.get(name, 0.0) > 0.0 and law.columns.shape[1] == 1
    }
    found = {"amplitude": normal(amplitude, std, effect.parameter("amplitude").unit)}
    traded = profiles.get(next(iter(profiles), ""))
    if traded is not None and traded[1] is not None:
        low, high = traded[1].interval
        if low < amplitude < high:
            found["amplitude"] = Estimate(
                amplitude, traded[1].std, effect.parameter("amplitude").unit, traded[1].interval
            )
    return found | _shapes(effect, law.shape, {n: own for n, (own, _) in profiles.items()})


def _shapes(
    effect: Effect, shape: Mapping[str, float], profiles: Mapping[str, Profile]
) -> dict[str, Estimate]:
    units = {p.name: p.unit for p in effect.parameters}
    found = {}
    for name, value in shape.items():
        if name in units:
            profile = profiles.get(name, Profile((value, value), 0.0))
            found[name] = Estimate(float(value), profile.std, units[name], profile.interval)
    return found


def _profile(law: Law, name: str, effect: Effect, laws: Laws, at) -> tuple[Profile, Profile | None]:  # type: ignore[no-untyped-def]
    def loss(value: float) -> float:
        return float(at(laws.at(effect, {**law.shape, name: value}))[0])

    parameter, best = effect.parameter(name), law.shape[name]
    if name == "at_s":
        instants = np.unique([*laws.means.from_s, best])
        return profile_interval(loss, best, 1.0, (parameter.low, parameter.high), instants), None
    own = profile_interval(
        loss, best, _REACH, (max(parameter.low, best / 30.0), min(parameter.high, best * 30.0))
    )
    traded = amplitude_interval(
        lambda value: at(laws.at(effect, {**law.shape, name: value})),
        own.interval,
        (parameter.low, parameter.high),
    )
    return own, traded


def of_pattern(pattern: Pattern) -> dict[str, Estimate]:
    """Parameters of a pattern within data sets: amplitude and phase from cosine and sine."""
    effect = CATALOGUE[pattern.effect]
    b, v = pattern.amplitudes, pattern.covariance
    unit = effect.parameter("amplitude").unit
    if b.size == 1:
        found = {"amplitude": normal(float(b[0]), float(np.sqrt(v[0, 0])), unit)}
    else:
        size = float(np.hypot(*b))
        along, across = b / size, np.array([-b[1], b[0]]) / size**2
        found = {
            "amplitude": normal(size, float(np.sqrt(along @ v @ along)), unit),
            "phase_rad": normal(float(np.arctan2(-b[1], b[0])), float(np.sqrt(across @ v @ across)), "rad"),
        }
    return found | _shapes(effect, pattern.shape, {})


def of_draws(fitted: Fitted, component: str, rate_scale_dps: float) -> Estimate:
    """Size of the independent errors of the rates, ppm, with the interval of its likelihood."""
    logs = dict(fitted.fit.log_variance)
    steps = np.linspace(-4.0, 4.0, 33)
    nll = [
        fitted.contrasts.nll(fitted.model.all, {**logs, component: logs[component] + float(s)}) for s in steps
    ]
    inside = steps[np.array(nll) < min(nll) + 0.5 * float(chi2.ppf(0.95, 1))]
    size = float(np.sqrt(fitted.fit.variance[component])) / rate_scale_dps / PPM
    low, high = size * np.exp(0.5 * inside[0]), size * np.exp(0.5 * inside[-1])
    return Estimate(size, float(high - low) / (2.0 * NORMAL_95), "ppm", (float(low), float(high)))
