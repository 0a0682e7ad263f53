"""Data sets that say nothing of the surface: those of a dead gyro, and single ones that are off by themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import hypergeom, kstest, norm, rankdata

from gyrocal.calibration.groups import rate_groups
from gyrocal.diagnosis.model.layers import Fitted, contrasts_of
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Estimate, Located
from gyrocal.diagnosis.rows.base import fit_surface
from gyrocal.diagnosis.rows.scatter import Finding, clipped_finding, dead_finding, dead_sets
from gyrocal.diagnosis.rows.series import Series, set_means
from gyrocal.diagnosis.sweeps.candidates import Candidate
from gyrocal.diagnosis.sweeps.changes import STEPS
from gyrocal.diagnosis.sweeps.coil import TOLL_NATS
from gyrocal.inference.additive import Component, precision
from gyrocal.physics.sampling import BURSTS
from gyrocal.units import NORMAL_95, STDS_PER_MAD

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: A data set this many times farther off than nearly all others is not of this recording; no more than this share is:
#: half as much again as is to be borne, since a few that are less far off count among the others.
_GROSS, _MOST_SHARE = 8.0, 0.15
#: Of the sets that are off, those by this share of the largest and more are told at a time.
_BENDS = 0.5
#: Data sets that lie by chance as they do in rate, temperature or time, or at one rate, with less probability are off together,
#: by physics.
_TOGETHER_P = 0.01
#: Fewer data sets show no single one beside the twelve terms of a surface; the robust fit settles in so many rounds.
_FEWEST_SETS, _ROUNDS = 30, 30
#: What a data set by itself must explain, nats: five standard deviations, which of 171 rows of white noise one does in 10,000
#: tables. Of 29 made-up tables without an outlier none had a row beyond 3.9, of six with outliers every one, beyond 5.
_STRAY_NATS = 12.5
#: Data sets at either end that may be off by physics: a transient, or a step that has hardly been seen. Either has the sets beyond
#: off as well, and does not go further off towards the middle.
_ENDS = 4
#: A row that the record knows less of than this share of what it knows of the others is one that some term is known from
#: alone: what is left of it is rounding.
_TOLD = 1e-6


@dataclass(frozen=True)
class Strays:
    """Data sets that are off by themselves.

    Attributes
    ----------
    numbers : ndarray, shape (k,)
        Of the data sets.
    off_dps : ndarray, shape (k,)
        By how much they are off.
    std_dps : ndarray, shape (k,)
        How well that is known.
    """

    numbers: Ints
    off_dps: Floats
    std_dps: Floats

    def __len__(self) -> int:
        return int(self.numbers.size)

    def less(self, numbers: Ints) -> Strays:
        """These but for some of them."""
        kept = ~np.isin(self.numbers, numbers)
        return Strays(self.numbers[kept], self.off_dps[kept], self.std_dps[kept])

    def joined(self, other: Strays) -> Strays:
        """These and others."""
        return Strays(
            np.concatenate([self.numbers, other.numbers]),
            np.concatenate([self.off_dps, other.off_dps]),
            np.concatenate([self.std_dps, other.std_dps]),
        )


#: No data set is off.
NO_STRAYS = Strays(np.empty(0, dtype=np.int64), np.empty(0), np.empty(0))


def without(series: Series, numbers: Ints) -> Series:
    """A series less some of its data sets."""
    return series.take(~np.isin(series.set_index, numbers)) if numbers.size else series


def set_aside(series: Series, output_dps: Floats) -> tuple[Series, list[Finding], Strays]:
    """The series without the data sets that say nothing of the surface, what dead and clipped ones tell, and the gross ones.

    Parameters
    ----------
    output_dps : ndarray, shape (n,)
        The output as recorded: a dead gyro says exactly 0, whatever has been taken off since.
    """
    findings: list[Finding] = []
    dead, lost_dps, reach = dead_sets(series, output_dps)
    if dead.size:
        findings.append(dead_finding(dead, lost_dps, reach, np.unique(series.set_index).size))
        output_dps, series = output_dps[~np.isin(series.set_index, dead)], without(series, dead)
    clipped, saturation = clipped_finding(series, output_dps)
    if saturation is not None:
        findings.append(saturation)
        series = without(series, clipped)
    gross = gross_strays(series)
    return without(series, gross.numbers), findings, gross


def gross_strays(series: Series) -> Strays:
    """Data sets that are grossly off a robust surface: mislabelled, disturbed.

    At most a few, here and there: many, and those that are off together, are physics, and left to the search.
    """
    bent = fit_surface(series).residual_dps
    numbers, rate = set_means(series, series.rate_dps)
    bad, off, std = np.zeros(numbers.size, dtype=np.bool_), np.zeros(numbers.size), np.zeros(numbers.size)
    while few := int(bad.sum()) <= _most(numbers.size):
        kept = ~np.isin(series.set_index, numbers[bad])
        others, left, spread = _off_robustly(series.take(kept), bent[kept])
        if not others.size:
            return NO_STRAYS
        size = np.abs(left) / spread
        # A set that is off by far bends what its neighbours are measured from.
        far = size > max(_GROSS * float(np.quantile(size, 1.0 - _MOST_SHARE)), _BENDS * float(size.max()))
        if not far.any():
            break
        at = np.searchsorted(numbers, others[far])
        bad[at], off[at], std[at] = True, left[far], spread[far]
    bad &= ~_of_one_rate(bad, rate) & ~_of_a_transient(off)
    places = [np.abs(rate), set_means(series, series.temp_c)[1], numbers.astype(np.float64)]
    if series.supply_v is not None:
        places.append(set_means(series, series.supply_v)[1])
    if not (few and bad.any()) or _together(bad, places):
        return NO_STRAYS
    return Strays(numbers[bad], off[bad], std[bad])


def _off_robustly(series: Series, left_dps: Floats) -> tuple[Ints, Floats, Floats]:
    """Data sets, by how much they are off a robust surface, and by how much such a set is as a rule; too few are none.

    Parameters
    ----------
    left_dps : what some model leaves of each row, shape (rows of the series,)
    """
    numbers, y = set_means(series, left_dps)
    if numbers.size < _FEWEST_SETS:
        return NO_STRAYS.numbers, NO_STRAYS.off_dps, NO_STRAYS.std_dps
    design = np.column_stack([set_means(series, column)[1] for column in fit_surface(series).design.T])
    rate = np.abs(set_means(series, series.rate_dps)[1])
    white = set_means(series, series.white_std_dps)[1]
    # What is known better than most may err by more than its own noise all the same.
    noisier = np.maximum(white / np.median(white), 1.0)
    left, spread = y, np.ones(numbers.size)
    for _ in range(_ROUNDS):
        weight = 1.0 / np.sqrt(spread**2 + (0.5 * left) ** 2)
        solution = np.linalg.lstsq(design * weight[:, None], y * weight, rcond=None)[0]
        left = y - design @ solution
        spread = _spread(left, rate, noisier)
    return numbers, left, spread


def _together(bad: NDArray[np.bool_], coordinates: Sequence[Floats]) -> bool:
    """Whether several of the sets lie closer to each other along a coordinate, shape (sets,) each, than by chance.

    By how they are spread over all of it, and by how short a stretch has them all.
    """
    if (count := int(bad.sum())) < 2:
        return False
    places = [(rankdata(x)[bad] - 0.5) / bad.size for x in coordinates]
    by_chance = [float(kstest(p, "uniform").pvalue) for p in places]
    stretches = [min(float(np.ptp(p)) + 1.0 / bad.size, 1.0) for p in places]
    by_chance += [count * s ** (count - 1) - (count - 1) * s**count for s in stretches]
    return len(by_chance) * min(by_chance) < _TOGETHER_P


def _of_a_transient(off_dps: Floats) -> NDArray[np.bool_]:
    """Which of the first sets, of shape (sets,) all, are off to the side that the one before or after is off to."""
    same = off_dps[1:] * off_dps[:-1] > 0.0
    found = np.append(same, False) | np.append(False, same)
    found[_ENDS:] = False
    return np.asarray(found, dtype=np.bool_)


def _of_one_rate(bad: NDArray[np.bool_], rate_dps: Floats) -> NDArray[np.bool_]:
    """Which of the sets are off at one rate, or at one both ways, of more of them than by chance: whatever they are, they come again."""
    found = np.zeros_like(bad)
    for group in (rate_groups(rate_dps), rate_groups(np.abs(rate_dps))):
        here, all_here = np.bincount(group, bad), np.bincount(group)
        # Of as many draws as sets are off so many or more hit the rate; any rate may be it.
        by_chance = hypergeom.sf(here - 1.0, bad.size, all_here, int(bad.sum()))
        together = (here > 1.0) & (np.count_nonzero(all_here) * by_chance < _TOGETHER_P)
        found |= bad & together[group]
    return found


def far_off(series: Series, left_dps: Floats) -> list[Remark]:
    """What is to be said of data sets that are grossly off all that was found: what they hide nobody sees.

    Parameters
    ----------
    left_dps : what the whole model leaves of each row, shape (rows of the series,)
    """
    numbers, left, spread = _off_robustly(series, left_dps)
    size = np.abs(left) / spread
    far = size > _GROSS * NORMAL_95
    if not far.any():
        return []
    facts = {"sets": (numbers[far] + 1).tolist(), "of": int(numbers.size), "times": float(np.min(size[far]))}
    return [Remark(Said.FAR_SETS, facts)]


def _spread(left: Floats, rate: Floats, noisier: Floats) -> Floats:
    """By how much sets are off, of which a part grows with the rate: the table's and the thermometer's error does.

    Parameters
    ----------
    noisier : noise of each set over that of most
    """
    fast, size = rate >= max(float(np.median(rate)), 1e-9), np.abs(left) / noisier
    off = STDS_PER_MAD * float(np.median(size)) + 1e-12
    share = STDS_PER_MAD * float(np.median(size[fast] / rate[fast])) if fast.any() else 0.0
    return np.asarray(noisier * np.hypot(off, share * rate))


def strays_beside(ranked: Sequence[Candidate], known: Strays) -> Strays:
    """Data sets of a table that are better explained as off by themselves than by any law.

    A single data set that is off looks like a step up and a step down again, so that models with steps are among its rivals.

    Parameters
    ----------
    ranked : models of the table, the best first
    known : data sets that have been left out of it; with them they must be few, since many are physics
    """
    best: dict[int, Candidate] = {}
    for c in ranked:
        best.setdefault(sum(change.effect in STEPS for change in c.changes), c)
    strays, _, beside = min(((*_alone(c), c) for c in best.values()), key=lambda f: f[2].score - f[1])
    means = beside.fitted.model.means
    chosen = np.isin(means.set_index, strays.numbers)
    strays = strays.less(means.set_index[_of_one_rate(chosen, means.rate_dps)])
    few = len(strays) + len(known) <= _most(len(beside.fitted.model.means))
    if not len(strays) or not few:
        return NO_STRAYS
    score = beside.score - _gain(beside.fitted, strays) + _toll(strays, beside.fitted)
    return strays if score < ranked[0].score else NO_STRAYS


def _toll(strays: Strays, fitted: Fitted) -> float:
    """What a law would pay for as many rows, nats."""
    return len(strays) * (TOLL_NATS + 0.5 * float(np.log(len(fitted.model.means))))


def _gain(fitted: Fitted, strays: Strays) -> float:
    """Evidence for strays, all variances fitted anew with them and without: a walk may have grown to make up for a step."""
    model = fitted.model
    rows = (model.means.set_index[:, None] == strays.numbers).astype(np.float64)
    contrasts = contrasts_of(model, designs=(rows,))
    logs = fitted.fit.log_variance
    without = contrasts.fit(model.all, logs)
    return without.nll - contrasts.fit([*model.all, Component("strays", rows)], logs).nll


def _alone(candidate: Candidate) -> tuple[Strays, float]:
    """Rows that are off by themselves beside a model, and roughly what they gain, nats: only the level of the noise follows."""
    model = candidate.fitted.model
    means, rows = model.means, len(model.means)
    chosen: list[int] = []
    gained = 0.0
    if rows < _FEWEST_SETS:
        return NO_STRAYS, gained
    variance = candidate.fitted.fit.variance
    flat = model.design[:, model.flat]
    score, p = precision(model.error_dps, flat, model.all, variance)
    off, std = np.empty(0), np.empty(0)
    while len(chosen) <= _most(rows):
        # Freed of those that were chosen (Student's t, profiled).
        inner = np.linalg.inv(p[np.ix_(chosen, chosen)]) if chosen else np.empty((0, 0))
        own, here = score - p[:, chosen] @ inner @ score[chosen], p - p[:, chosen] @ inner @ p[chosen]
        off, std = inner @ score[chosen], np.sqrt(np.diag(inner))
        known = np.diag(here) > _TOLD * np.median(np.diag(p))
        away = np.where(known, own / np.where(known, np.diag(here), 1.0), 0.0)
        squares = away * own
        squares[_as_of_an_end(away)] = 0.0
        freedom = float(model.error_dps @ score) - float(score[chosen] @ off)
        gains = 0.5 * (rows - flat.shape[1]) * -np.log1p(-np.minimum(squares / freedom, 1.0 - 1e-9))
        k = int(np.argmax(gains))
        if gains[k] < _STRAY_NATS:
            break
        gained += float(gains[k])
        chosen.append(k)
    else:
        # So many are physics.
        return NO_STRAYS, 0.0
    return Strays(means.set_index[chosen], off, std), gained


def _as_of_an_end(off: Floats) -> Ints:
    """Rows near either end that a transient or a step may have made: a row beyond them is off by half as much or more.

    Parameters
    ----------
    off : by how much each row is off, shape (rows,), in whatever unit
    """
    rows, size = np.arange(_ENDS), np.abs(off)
    ends = [(rows, size[:_ENDS]), (off.size - 1 - rows, size[::-1][:_ENDS])]
    followed = [at[[bool(np.any(y[:k] > 0.5 * y[k])) for k in rows]] for at, y in ends]
    return np.concatenate(followed)


def _most(sets: int) -> int:
    return max(1, int(_MOST_SHARE * sets))


def stray_findings(series: Series, strays: Strays) -> list[Finding]:
    """One finding for all data sets that are left out."""
    if not len(strays):
        return []
    rows = [np.flatnonzero(series.set_index == n)[0] for n in strays.numbers]
    sets = [
        (int(n) + 1, float(series.rate_dps[r]), float(series.temp_c[r]), 1e3 * float(d))
        for n, r, d in zip(strays.numbers, rows, strays.off_dps, strict=True)
    ]
    most = int(np.argmax(np.abs(strays.off_dps)))
    amplitude = Estimate.normal(
        1e3 * float(abs(strays.off_dps[most])), 1e3 * float(strays.std_dps[most]), "mdeg/s"
    )
    sigmas = float(np.max(np.abs(strays.off_dps) / strays.std_dps))
    p = min(1.0, np.unique(series.set_index).size * 2.0 * float(norm.sf(sigmas)))
    place = Located("data_set_index", "mean", p, 1.0, target="data sets", finding=BURSTS.id)
    return [Finding(BURSTS.id, Remark(Said.STRANGE_SETS, {"sets": sets}), {"amplitude": amplitude}, p, place)]
