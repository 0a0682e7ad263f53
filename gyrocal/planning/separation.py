"""How well a plan tells an effect from what else it could be, whichever is true.

The share R^2 of an effect's whitened signature that another captures, and the effect's signal-to-noise ratio d'
under the noise that is there, are known before any data: to tell the two at 20 : 1 the expected difference in
log-likelihood, d'^2 (1 - R^2)/2, must be 3 nats, so d' >= sqrt(6/(1 - R^2)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from gyrocal.diagnosis.answer.untimed import by_time
from gyrocal.diagnosis.result import Diagnosis, NamedEffect, Rows
from gyrocal.diagnosis.rows.base import simulate
from gyrocal.diagnosis.rows.columns import conditions_of, offer_of
from gyrocal.diagnosis.rows.series import Series
from gyrocal.inference.gram import Projection, project
from gyrocal.inference.whitening import NoiseLevels, NoiseModel
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.surface import Surface
from gyrocal.planning.planned import Design, Reach, planned_series
from gyrocal.units import DEG_PER_RT_H_TO_DPS_PER_RT_HZ, DPH_TO_DPS, S_PER_MIN

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Evidence that counts as settled: 20 : 1, in nats.
_SETTLED_NATS = 3.0
GOOD_POWER = 0.95
#: Of the report's figures, a standard unit, where the record carries none.
_USUAL_WALK_DEG_PER_RT_H = 0.083
#: Columns of less whitened power are not there.
_NOTHING = 1e-18
#: An effect of less d' does not show in a plan.
_SEEN_AT_ALL = 1e-3


@dataclass(frozen=True)
class Separation:
    """How well a plan tells an effect from another.

    Attributes
    ----------
    d_prime : float
        Signal-to-noise ratio of the effect in the planned record.
    captured : float
        Share R^2 of its signature that the other captures.
    power : float
        Probability of at least 20 : 1 for the effect where it is the true one.
    if_other : Separation or None
        The same where the other one is true; None: the record does not show what it would then be.
    odds : float
        Of the effect against the other, by the record at hand.
    """

    other: str
    d_prime: float
    captured: float
    power: float
    if_other: Separation | None = None
    odds: float = 1.0

    @property
    def d_prime_needed(self) -> float:
        """d' at which 20 : 1 is expected."""
        return float(np.sqrt(2.0 * _SETTLED_NATS / max(1.0 - self.captured, 1e-9)))

    @property
    def expected_power(self) -> float:
        """Probability of at least 20 : 1 for the true one, whichever that is."""
        if self.if_other is None:
            return self.power
        return (self.odds * self.power + self.if_other.power) / (self.odds + 1.0)


def repeats_needed(separations: Sequence[Separation]) -> int:
    """How often a plan must be run so that every pair reaches `GOOD_POWER`."""
    quantile = float(norm.ppf(GOOD_POWER))
    needed = (quantile + float(np.sqrt(quantile**2 + 2.0 * _SETTLED_NATS))) ** 2
    both = [*separations, *(s.if_other for s in separations if s.if_other is not None)]
    each = min(s.d_prime**2 * (1.0 - s.captured) for s in both)
    return int(np.ceil(needed / max(each, needed / 1e6)))


def separate(
    diagnosis: Diagnosis, effect: NamedEffect, others: Sequence[str], design: Design, reach: Reach
) -> tuple[Separation, ...]:
    """What a design would tell about an effect of the size that was found, against each of the others.

    Whichever is true, it must show: each of the others at the size and shape that would have left this record.
    """
    if diagnosis.surface is None:
        return ()
    surface = diagnosis.surface.surface
    series = planned_series(design, reach, _walk_dps_rt_s(diagnosis))
    planned = _Planned(series, surface, NoiseModel(series), _levels(diagnosis))
    signature = _signature(effect, series, surface)
    odds = {a.effect: a.evidence_ratio for a in effect.alternatives}
    found = planned.against(signature, others)
    for k, other in enumerate(others):
        mimic = _mimic(diagnosis, effect, other, planned)
        if mimic is not None:
            (back,) = planned.against(mimic, [effect.effect])
            found[k] = replace(found[k], if_other=back, odds=odds.get(other, 1.0))
    return tuple(found)


@dataclass(frozen=True)
class _Planned:
    """The rows that a design would record, and the noise in them."""

    series: Series
    surface: Surface
    noise: NoiseModel
    levels: NoiseLevels

    def against(self, signature: Floats, others: Sequence[str]) -> list[Separation]:
        """How well a signature, shape (n,), is told from each of the others at whatever shape suits it."""
        base = simulate(self.series, self.surface).design
        grids = [_grid(other, self.series, self.surface) for other in others]
        columns = np.column_stack([signature, base, *(g for grid in grids for g in grid)])
        white = self.noise.whiten(self.levels, columns)[0]
        left = project(white.T @ white, np.arange(base.shape[1]))
        first, pairs = base.shape[1], []
        for other, grid in zip(others, grids, strict=True):
            d_prime = float(np.sqrt(max(left.rss, 0.0)))
            if CATALOGUE[other].search.draws:
                columns_of = np.arange(first, first + grid[0].shape[1])
                first += columns_of.size
                pairs.append(_against_draws(other, d_prime, left, columns_of))
                continue
            captured = 0.0
            for point in grid:
                captured = max(captured, left.block(np.arange(first, first + point.shape[1]))[0])
                first += point.shape[1]
            share = min(captured / left.rss, 1.0) if left.rss > 0 else 1.0
            pairs.append(Separation(other, d_prime, share, power_of(d_prime, share)))
        return pairs


def _mimic(diagnosis: Diagnosis, effect: NamedEffect, other: str, planned: _Planned) -> Floats | None:
    """In the planned rows, what the other would be if it had made what the effect was found to add; shape (n,)."""
    rows, known = diagnosis.rows, CATALOGUE[other]
    added = None if rows is None else rows.effect_dps.get(effect.effect)
    if rows is None or added is None or known.search.draws:
        return None
    seen, plan = _conditions_of_rows(rows), conditions_of(planned.series)
    if any(getattr(c, need) is None for c in (seen, plan) for need in known.needs):
        return None
    flat = planned.surface.design(rows.rate_dps, rows.temp_c)
    best, found = np.inf, None
    for shape in known.search.grid(offer_of(planned.series)):
        column = known.unit_dps(seen, shape, planned.surface)
        amounts, *_ = np.linalg.lstsq(np.column_stack([column, flat]), added, rcond=None)
        left = float(np.sum((added - np.column_stack([column, flat]) @ amounts) ** 2))
        if left < best:
            best, found = left, amounts[0] * known.unit_dps(plan, shape, planned.surface)
    return found


def _conditions_of_rows(rows: Rows) -> Conditions:
    """What the laws of the catalogue may depend on, in the rows of the record at hand."""

    def logged(x: Floats) -> Floats | None:
        return x if np.isfinite(x).all() else None

    return Conditions(
        rows.t_s,
        rows.rate_dps,
        rows.temp_c,
        angle_deg=logged(rows.angle_deg),
        supply_v=logged(rows.supply_v),
        since_power_on_s=rows.t_s - rows.t_s[0]
        if logged(rows.since_power_on_s) is None
        else rows.since_power_on_s,
        since_step_s=logged(rows.since_set_s),
        step_dps=logged(rows.step_dps),
        temp_rate_c_per_s=rows.temp_rate_c_per_min / S_PER_MIN,
        data_set_index=rows.set_index.astype(np.float64),
    )


def _against_draws(other: str, d_prime: float, left: Projection, columns: Ints) -> Separation:
    """How well a law is told from independent draws of one size, one for each rate.

    Draws can follow any law, and pay for it: their evidence, at the size that suits them best, is
    ``sum(w_k (b_k^2 + 1) - log(1 + s^2 l_k))/2`` over their orthogonal patterns of strength l_k, of which the
    law has the components b_k, ``w_k = s^2 l_k / (1 + s^2 l_k)``; the 1 is what noise adds to a square.
    """
    strength, patterns = np.linalg.eigh(left.gram[np.ix_(columns, columns)])
    kept = strength > max(1e-6 * float(strength[-1]), _NOTHING)
    if not kept.any() or d_prime < _SEEN_AT_ALL:
        return Separation(other, d_prime, 1.0, 0.0)
    strength = strength[kept]
    along = (patterns[:, kept].T @ left.score[columns]) ** 2 / strength
    best, share, spread = 0.0, 0.0, 1.0
    for size in np.geomspace(1e-3, 1e4, 141) / np.sqrt(float(np.median(strength))):
        weight = size**2 * strength / (1.0 + size**2 * strength)
        gain = 0.5 * float(np.sum(weight * (along + 1.0) - np.log1p(size**2 * strength)))
        if gain > best:
            best, share = gain, gain / max(0.5 * d_prime**2, 1e-300)
            spread = float(np.sum((1.0 - weight) ** 2 * along + 0.5 * weight**2))
    beyond = max(d_prime**2 - float(along.sum()), 0.0)
    mean = 0.5 * (d_prime**2 + 1.0) - best
    power = float(norm.sf((_SETTLED_NATS - mean) / np.sqrt(spread + beyond)))
    return Separation(other, d_prime, float(np.clip(share, 0.0, 1.0)), power)


def power_of(d_prime: float, captured: float) -> float:
    """Probability that the log-likelihood ratio exceeds 3 nats when its mean is half its variance."""
    variance = d_prime**2 * max(1.0 - captured, 0.0)
    if variance <= 0:
        return 0.0
    return float(norm.sf((_SETTLED_NATS - variance / 2.0) / np.sqrt(variance)))


def _signature(effect: NamedEffect, series: Series, surface: Surface) -> Floats:
    """The named effect in the planned rows, at its estimated size, shape (n,)."""
    shape = by_time(effect.parameters)
    size = shape.pop("amplitude", 1.0)
    c = conditions_of(series)
    known = CATALOGUE[effect.effect]
    if known.search.draws:
        # Draws of one size and of alternating sign stand for draws.
        each = known.columns(c, {}, surface)
        return np.asarray(size * (each @ (-1.0) ** np.arange(each.shape[1])))
    if "at_s" in shape:
        # The old instant means nothing in a new run: what matters is a jump in its middle.
        shape["at_s"] = float(series.t_s.mean())
    return np.asarray(size * known.unit_dps(c, shape, surface))


def _grid(effect: str, series: Series, surface: Surface) -> list[Floats]:
    """Columns of an effect for each of its shapes in the planned rows, each of shape (n, k)."""
    c = conditions_of(series)
    known = CATALOGUE[effect]
    if any(getattr(c, need) is None for need in known.needs):
        return [np.zeros((len(series), 1))]
    return [known.columns(c, shape, surface) for shape in known.search.grid(offer_of(series))]


def _walk_dps_rt_s(diagnosis: Diagnosis) -> float:
    """Angle random walk; of a table, whose rows do not say what time they average over, from their distance."""
    noise, rows = diagnosis.noise, diagnosis.rows
    walk = noise.angle_random_walk_deg_per_rt_h if noise is not None else None
    if walk is None and noise is not None and rows is not None and rows.t_s.size > 1:
        return noise.white_std_dps * float(np.sqrt(max(np.median(np.diff(rows.t_s)), 0.01)))
    return (walk or _USUAL_WALK_DEG_PER_RT_H) * DEG_PER_RT_H_TO_DPS_PER_RT_HZ


def _levels(diagnosis: Diagnosis) -> NoiseLevels:
    """Noise levels in the planned rows, whose ``white_std_dps`` is the white noise itself."""
    noise = diagnosis.noise
    if noise is None:
        return NoiseLevels(1.0, 1e-9, 1e-9)
    # A decade apart, processes of variance s^2 add up to the density s^2/(ln 10 f), which is B^2/(pi f).
    flicker = noise.bias_instability_deg_per_h * DPH_TO_DPS * float(np.sqrt(np.log(10.0) / np.pi))
    return NoiseLevels(1.0, max(flicker, 1e-9), max(noise.rate_jitter_ppm * 1e-6, 1e-9))
