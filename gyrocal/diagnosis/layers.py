"""The layers of a recording: one additive model, all variances at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.base import carried_terms
from gyrocal.diagnosis.means import Means
from gyrocal.diagnosis.parts import FLAT, PASSING, SURFACE, Basis, Part, design_at, frame_of, passing, staying
from gyrocal.diagnosis.powers import legendre_to_powers
from gyrocal.errors import DataError
from gyrocal.inference import additive
from gyrocal.inference.additive import Component, Contrasts, Fit, Solution, solve
from gyrocal.physics.surface import SHAPE, Surface

Floats = NDArray[np.float64]

#: Components below this (logarithm of the share of the record's variance) have died and cost time only.
_DEAD = -16.0
#: Components of a scale factor that wanders.
WANDERING_SCALE = ("scale line", "scale walk")
#: Instants at which a long record is looked at for steps of the bias and the scale factor.
_STEPS = 60
#: Name of the component that bends a surface of the input to one of the output.
DIRECTION = "direction"
#: Prior variance of a law for the scan of shapes, in that of what the surface leaves: strong laws hide in it.
_WIDE = 25.0


@dataclass(frozen=True)
class Law:
    """A law of the catalogue at some shape, as columns of the model.

    Attributes
    ----------
    columns : ndarray, shape (n, q)
        At unit amplitude, at the rows of the means.
    from_end : bool
        Whether a law of time counts from the end of the record, where it is zero, instead of its beginning.
    """

    effect: str
    shape: Mapping[str, float]
    columns: Floats = field(repr=False)
    from_end: bool = False

    @property
    def name(self) -> str:
        """Name of its component."""
        return f"{self.effect} {sorted(self.shape.items())}"


@dataclass(frozen=True)
class Model:
    """What is in the model of a recording.

    Attributes
    ----------
    design : ndarray, shape (n, 12)
        Surface at the rows (of the coil's temperature, where that is in the model).
    parts : mapping
        Name to component, of what stays, by `blocks`; surface included.
    passing : mapping
        The same of what passes.
    laws : tuple of Law
    flat : tuple of int
        Terms of the surface that are free: those of `FLAT` that the record carries.
    direction : str
        Whether the surface is one of the ``input`` or of the ``output``, or ``free``: a part of the model.
    bend : ndarray, shape (12,), optional
        Coefficients of the surface, of Legendre products, whose bend makes one of the output of one of the input.
    law_variance : float
        Prior variance of what a law adds beyond the surface's free terms, for a scan of shapes.
    """

    means: Means
    basis: Basis
    design: Floats
    parts: tuple[Part, ...]
    components: Mapping[str, Component]
    laws: tuple[Law, ...] = ()
    law_variance: float = 1.0
    direction: str = "input"
    bend: Floats | None = field(default=None, repr=False)
    flat: tuple[int, ...] = FLAT

    @property
    def error_dps(self) -> Floats:
        """What the model is of: gyro minus reference, less what makes a surface one of the output."""
        error = self.means.error_dps
        if self.direction != "output" or self.bend is None:
            return error
        return error - direction_at(self.basis, self.bend)

    def directed(self, direction: str, bend: Floats) -> Model:
        """The same with a surface of this direction.

        Parameters
        ----------
        bend : coefficients of the surface as far as they are known
        """
        known = self.without([DIRECTION])
        if direction == "free":
            column = Component(DIRECTION, direction_at(self.basis, bend)[:, None])
            known = replace(known, components={**known.components, DIRECTION: column})
        return replace(known, direction=direction, bend=bend)

    def legendre(self, solution: Solution) -> Floats:
        """Coefficients of the surface, of Legendre products, shape (12,)."""
        c = np.zeros(len(SURFACE))
        c[list(self.flat)] = solution.flat
        for part in self.parts:
            if part.block == "surface" and part.name in solution.amplitudes:
                at = [SURFACE.index(column) for column in part.columns]
                c[at] = solution.amplitudes[part.name] * np.array(part.weights)
        return c

    @property
    def blocks(self) -> dict[str, str]:
        """Component to the block that it is taken out with; noise and surface belong to none."""
        own = {p.name: p.block for p in self.parts if p.block != "surface"}
        # What is neither of the input nor of the output bends with the rate as odd orders do.
        own |= {DIRECTION: "odd rate", **PASSING}
        return {n: b for n, b in own.items() if n in self.components}

    @property
    def all(self) -> list[Component]:
        """Every component, laws included."""
        return [*self.components.values(), *(self.law_component(law) for law in self.laws)]

    def law_component(self, law: Law) -> Component:
        """A law, whose variance is estimated as that of a smooth part is, so that the two can be compared."""
        return Component(law.name, law.columns)

    def without(self, names: Sequence[str]) -> Model:
        """The same less some components."""
        return replace(self, components={n: c for n, c in self.components.items() if n not in names})

    def alive(self, fit: Fit) -> Model:
        """The same less what has died."""
        dead = [n for n in self.components if n != "white" and fit.log_variance.get(n, 0.0) < _DEAD]
        return self.without(dead)


@dataclass(frozen=True)
class Fitted:
    """A model with its variances."""

    model: Model
    fit: Fit
    contrasts: Contrasts = field(repr=False)

    @property
    def nll(self) -> float:
        """Negative log evidence, nats."""
        return self.fit.nll

    def solve(self, *, widened: bool = False) -> Solution:
        """Amplitudes of everything; `widened`: their covariance with that of the variances."""
        m, variance = self.model, self.fit.variance
        found = solve(m.error_dps, m.design[:, m.flat], m.all, variance)
        if not widened:
            return found
        wide = additive.widened(m.error_dps, m.design[:, m.flat], m.all, variance, found)
        return replace(found, covariance=wide)

    def refit(self, model: Model, iterations: int = 60) -> Fitted:
        """Another model of the same record, from these variances."""
        ways = {model.direction, self.model.direction}
        same = model.design is self.model.design and (model.bend is self.model.bend or "output" not in ways)
        same = same and ("output" not in ways or len(ways) == 1)
        contrasts = self.contrasts if same else contrasts_of(model, self.contrasts.unit)
        return Fitted(model, contrasts.fit(model.all, self.fit.log_variance, iterations), contrasts)


def contrasts_of(model: Model, unit: float | None = None) -> Contrasts:
    """The record freed of the surface's free terms; `unit` of another model that it is compared with."""
    columns = [c.columns for c in model.components.values() if c.columns is not None]
    steps = np.tri(len(model.means))[:, :: max(1, len(model.means) // _STEPS)]
    u = model.means.rate_dps / model.basis.frame.rate_scale_dps
    span = np.concatenate([*columns, steps, steps * u[:, None]], axis=1)
    return Contrasts(model.error_dps, model.design[:, model.flat], span, unit)


def full_model(means: Means, *, memory: bool = True) -> Model:
    """Everything that a calibration may contain."""
    basis = Basis(means, frame_of(means))
    carried = carried_terms(means.series)
    parts = tuple(staying(means, basis.frame, carried, memory=memory))
    design = basis.at(SURFACE)
    components = {p.name: basis.component(p) for p in parts}
    # Where laws of time are searched for, a scale factor that wanders would take their place.
    later = () if memory else WANDERING_SCALE
    components |= {c.name: c for c in passing(means, basis.frame) if c.name not in later}
    left = means.error_dps - design @ np.linalg.lstsq(design, means.error_dps, rcond=None)[0]
    flat = tuple(k for k in FLAT if k in carried)
    wide = _WIDE * float(np.mean(left**2))
    return Model(means, basis, design, parts, components, law_variance=wide, flat=flat)


def direction_at(rows: Basis, bend: Floats) -> Floats:
    """What a surface over the output adds to the same one over the input, shape (n,), deg/s.

    Its output is that of a gyro with the surface alone, as where a robot corrects: everything else adds to it.
    """
    here, frame = rows.means, rows.frame
    powers = (legendre_to_powers() @ bend).reshape(SHAPE)
    surface = Surface(
        powers, 0.0, frame.rate_scale_dps, frame.temp_center_c, frame.temp_scale_c, direction="output"
    )
    try:
        output = surface.output_dps(here.rate_dps, here.temp_c)
    except DataError:
        # A surface on the way to the right one may have no output at some rate; what was recorded is near it.
        output = here.gyro_dps
    of_output = design_at(output, here.temp_c, frame)
    return np.asarray((of_output - design_at(here.rate_dps, here.temp_c, frame)) @ bend)


def fit_model(model: Model, start: Mapping[str, float] | None = None, iterations: int = 60) -> Fitted:
    """Variances of a model."""
    contrasts = contrasts_of(model)
    return Fitted(model, contrasts.fit(model.all, start, iterations), contrasts)
