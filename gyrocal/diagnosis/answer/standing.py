"""Where bias and scale factor stand in the file, of what passes: at the end of the record, or in the mean over it."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.laws.in_place import passes
from gyrocal.diagnosis.model.layers import Model
from gyrocal.diagnosis.model.parts import DRIFTING_BIAS, DRIFTING_SCALE, SURFACE, legendre_to_powers
from gyrocal.diagnosis.sweeps.changes import DRIFTS
from gyrocal.inference.additive import Solution
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.surface import SHAPE

Floats = NDArray[np.float64]


def state_of_laws(model: Model) -> dict[str, tuple[float, float]]:
    """Laws of time as they stand at the end of the record, at an amplitude of one: a constant and a share of the rate."""
    means, scale = model.means, model.basis.frame.rate_scale_dps
    t = np.full(2, means.to_s[-1])
    temp = np.full(2, means.temp_c[-1])
    c = Conditions(t, np.array([0.0, scale]), temp)
    found = {}
    for law in model.laws:
        effect = CATALOGUE[law.effect]
        if law.from_end or not passes(effect):
            continue
        standing, turning = effect.unit_dps(c, law.shape, None).tolist()
        found[law.name] = standing, turning - standing
    return found


def state_of_walks(model: Model, solution: Solution, fallen: Collection[str]) -> tuple[Floats, float]:
    """Terms of the surface from where bias and scale factor have walked about, shape (12,), and the variance that the fallen leave, deg/s squared.

    In the mean: how far a walk goes on until another run nobody knows, and what is taken for one may be what a gyro does again.

    Parameters
    ----------
    fallen : components that stand for what the gyro has and the file lacks
        Their end is no state of the gyro: the surface takes what it can of them over the whole record.
    """
    columns_of = {c.name: c.columns for c in model.all}
    whole = np.zeros(len(model.means))
    for name in sorted(fallen):
        columns = columns_of[name]
        whole += solution.random[name] if columns is None else columns @ solution.amplitudes[name]
    free = list(model.flat)
    onto = np.zeros(len(SURFACE))
    onto[free] = np.linalg.lstsq(model.design[:, free], whole, rcond=None)[0]
    left_dps2 = float(np.mean((whole - model.design @ onto) ** 2))
    mean = np.zeros(len(SURFACE))
    mean[0], mean[SHAPE[1]] = map(np.mean, _walks(model, solution, fallen))
    return legendre_to_powers() @ onto + mean, left_dps2


def left_by_drifts(model: Model, solution: Solution) -> tuple[float, float]:
    """Variances that walks and the drifts of a table leave about the mean that the surface has of them, deg/s squared: of the constant, and of the share of the rate.

    All of these go on, and where they stand in another run nobody knows.
    """
    constant, share = (float(np.var(walk)) for walk in _walks(model, solution))
    drifts = {law.name: law.columns for law in model.laws if law.from_end and law.effect in DRIFTS}
    smooth = {n: c.columns for n, c in model.components.items() if n in (DRIFTING_BIAS, DRIFTING_SCALE)}
    with_rate = {law.name for law in model.laws if "rate_dps" in CATALOGUE[law.effect].needs}
    for name, columns in (drifts | smooth).items():
        if columns is None or name not in solution.amplitudes:
            continue
        added = columns @ solution.amplitudes[name]
        if name in with_rate or name == DRIFTING_SCALE:
            share += float(np.mean(_of_scale(model, added) ** 2))
        else:
            constant += float(np.mean(added**2))
    return constant, share


def _walks(model: Model, solution: Solution, fallen: Collection[str] = ()) -> tuple[Floats, Floats]:
    """Where the constant has walked to in each row, and the scale factor as `_of_scale` has it."""
    still = np.zeros(len(model.means))
    bias, scale = (
        still if name in fallen else solution.random.get(name, still) for name in ("bias walk", "scale walk")
    )
    return bias, _of_scale(model, scale)


def _of_scale(model: Model, added: Floats) -> Floats:
    """What goes with the rate, for the largest one: in each row that turns; zero where none does."""
    turning = model.means.rate_dps != 0.0
    if not turning.any():
        return np.zeros(1)
    return np.asarray(added[turning] / model.means.rate_dps[turning] * model.basis.frame.rate_scale_dps)
