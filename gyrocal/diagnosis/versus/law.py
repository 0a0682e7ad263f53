"""The law between a recording and a simulation: surface, and terms of gyro and bench alike, as far as the data show them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.fit import rms
from gyrocal.diagnosis.result import Diagnosis
from gyrocal.diagnosis.rows.base import carried_terms
from gyrocal.diagnosis.rows.columns import conditions_of
from gyrocal.diagnosis.rows.series import Series, set_means
from gyrocal.errors import DataError
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.physics.catalogue import find_effect
from gyrocal.physics.smooth import SmoothTerm
from gyrocal.physics.surface import SHAPE
from gyrocal.physics.terms import Term
from gyrocal.records.files import finite

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Coefficients of the surface, row-major over the orders of rate and temperature.
_BIAS_AND_SCALE = np.array([0, SHAPE[1]])
#: Terms are not seen that together add less than this share of the variance of what the law leaves, which is a percent of its
#: rms, and are worth less than so many nats by the data sets.
_UNSEEN_SHARE, _UNSEEN_NATS = 0.02, 2.0


@dataclass(frozen=True)
class Unseen:
    """Terms that models have which are about as likely, and that the data do not show.

    `rms_dps`: what they add together to the means of the data sets.
    """

    count: int
    rms_dps: float


def law_of(found: Diagnosis, difference: Series) -> tuple[Coefficients, Unseen | None]:
    """The model of the difference, bench and all: surface, terms, and what was named that no robot sees; and what is not seen of it.

    A coefficient file keeps of a drift or a jump only where it left the gyro. Here the laws themselves stand, and the
    surface gives back what it held of them: bias and scale factor are fitted again beside them. A name that smooth
    parts of the file stand for takes their place, where it leaves no more than they do.
    """
    law = found.improved or found.surface
    if law is None:
        raise DataError(f"{found.recording}: the difference has no surface. Give recordings of a bench.")
    known = {term.name for term in law.terms}
    square = _square_of(law, difference)
    for e in found.effects:
        if e.effect in known or not difference.has_time or not _is_function(e.effect):
            continue
        parameters = {
            n: {"value": p.value, "std": finite(p.std), "unit": p.unit} for n, p in e.parameters.items()
        }
        term = Term(e.effect, parameters, False)
        beside = _refitted(replace(law, terms=(*law.terms, term)), difference, _BIAS_AND_SCALE)
        if (less := _square_of(beside, difference)) < square:
            law, square = beside, less
            continue
        others = [t for t in law.terms if not (isinstance(t, SmoothTerm) and t.family == e.family)]
        instead = _refitted(replace(law, terms=(*others, term)), difference, carried_terms(difference))
        fewer = sum(len(t.columns) for t in law.terms if isinstance(t, SmoothTerm) and t not in others)
        # What so many columns more take of noise alone (Akaike).
        if (less := _square_of(instead, difference)) < square * (1.0 + 2.0 * fewer / len(difference)):
            law, square = instead, less
    return _without_unseen(law, difference, {e.effect for e in found.effects})


def _without_unseen(
    law: Coefficients, difference: Series, named: Collection[str]
) -> tuple[Coefficients, Unseen | None]:
    """A law without the terms that add nothing visible, and what these were; None where all are seen.

    What they add to each coefficient of the surface is in its uncertainty.

    Parameters
    ----------
    named : effects that stay, whatever they add
    """
    c = conditions_of(difference)
    rows = [term.error_dps(c, law.surface) for term in law.terms]
    means = [set_means(difference, x)[1] for x in rows]
    left = set_means(difference, left_by(law, difference))[1]
    share = min(_UNSEEN_SHARE, 2.0 * _UNSEEN_NATS / left.size)
    free = [k for k, t in enumerate(law.terms) if isinstance(t, SmoothTerm) or t.effect not in named]
    free.sort(key=lambda k: rms(means[k]))
    together = np.cumsum(np.reshape([means[k] for k in free], (len(free), left.size)), axis=0)
    small = [n for n, sum_dps in enumerate(together, 1) if rms(sum_dps) ** 2 <= share * rms(left) ** 2]
    if not small:
        return law, None
    gone = free[: small[-1]]
    X = law.surface.output_design(difference.rate_dps, difference.temp_c)[:, carried_terms(difference)]
    moved = np.zeros(law.surface.coefficients_dps.size)
    moved[carried_terms(difference)] = np.linalg.lstsq(
        X, np.sum([rows[k] for k in gone], axis=0), rcond=1e-10
    )[0]
    kept = replace(
        law,
        terms=tuple(t for k, t in enumerate(law.terms) if k not in gone),
        covariance_dps2=law.covariance_dps2 + np.outer(moved, moved),
    )
    return kept, Unseen(len(gone), rms(together[len(gone) - 1]))


def _square_of(law: Coefficients, difference: Series) -> float:
    """Weighted sum of squares of what a law leaves of the data sets."""
    rows = difference.is_set | ~difference.is_set.any()
    left = left_by(law, difference)[rows] / difference.white_std_dps[rows]
    return float(left @ left)


def _refitted(law: Coefficients, difference: Series, terms: Ints) -> Coefficients:
    """A law with these terms of its surface fitted again beside the others."""
    rows = difference.is_set | ~difference.is_set.any()
    weight = 1.0 / difference.white_std_dps[rows]
    X = law.surface.output_design(difference.rate_dps[rows], difference.temp_c[rows])[:, terms]
    left = left_by(law, difference)[rows]
    more = np.zeros(law.surface.coefficients_dps.size)
    more[terms] = np.linalg.lstsq(X * weight[:, None], left * weight, rcond=1e-10)[0]
    c = law.surface.coefficients_dps + more.reshape(SHAPE)
    return replace(law, surface=replace(law.surface, coefficients_dps=c))


def _is_function(effect_id: str) -> bool:
    """Whether a law says what each sample gets: not what the sampling does to it, nor a draw that nobody knows."""
    effect = find_effect(effect_id)
    return effect.family != "sampling" and all(p.name != "seed" for p in effect.parameters)


def left_by(law: Coefficients, difference: Series) -> Floats:
    """What a law leaves of a difference, row by row, deg/s."""
    c = conditions_of(difference)
    added = sum(term.error_dps(c, law.surface) for term in law.terms)
    return np.asarray(
        difference.gyro_dps - law.surface.output_dps(difference.rate_dps, difference.temp_c) - added
    )
