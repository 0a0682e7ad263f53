"""The layers of a recording: one additive model, all variances at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.model.parts import (
    FLAT,
    ODD,
    PASSING,
    SURFACE,
    Basis,
    Part,
    design_at,
    frame_of,
    legendre_to_powers,
    passing,
    slope_by_temperature,
    staying,
)
from gyrocal.diagnosis.rows.base import carried_terms
from gyrocal.diagnosis.rows.means import Means
from gyrocal.diagnosis.rows.series import Series
from gyrocal.inference import additive
from gyrocal.inference.additive import Component, Contrasts, Fit, Solution, solve
from gyrocal.inference.rounding import harmonic, mean_error_std
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.rate import ROUNDS
from gyrocal.physics.smooth import Frame
from gyrocal.physics.surface import SHAPE, Surface

Floats = NDArray[np.float64]

#: Components below this (logarithm of the share of the record's variance) have died and cost time only.
_DEAD = -16.0
#: What adds less than this share of the noise of a row anywhere is left out of the file.
NEGLIGIBLE = 0.03
#: Components of a scale factor, and of a bias, that wander.
WANDERING_SCALE, WANDERING_BIAS = ("scale line", "scale walk"), ("bias walk",)
#: Instants at which a long record is looked at for steps of the bias and the scale factor.
_STEPS = 60
#: Name of the component that bends a surface of the input to one of the output.
DIRECTION = "direction"
#: Name of the component of what is not known of the temperature.
THERMOMETER = "thermometer"
#: Name of the component of what the steps of the output leave.
ROUNDING, STANDING = "rounding", "rounding where the output stands"
#: Rounding of less than this share of the scatter of samples is none: means of ten thousand of them know no better.
_FINE = 0.01
#: Harmonics of the steps of the output, that stand for all of them.
_HARMONICS = 5
#: Share of the variance of its rounding that rows have in common where the output stands on one step.
_STANDING_ALIKE = 0.5
#: Rounds in which the surface is freed of rounding and says where between two steps the output is.
_PHASES = 4
#: Prior variance of a law for the scan of shapes, in that of what the surface leaves: strong laws hide in it.
_WIDE = 25.0
#: Name of the component of what is not known of an open loop's phase.
PHASE = "phase"


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """The sine that an open loop puts out, whole: the model is of what there is beside it.

    Attributes
    ----------
    phase_rad_per_dps : float
        As far as it is known.
    sine_dps : ndarray, shape (n,)
        What it adds to the rate, at the rows of the means.
    by_phase : ndarray, shape (n, 1)
        Its derivative by the logarithm of the phase.
    spread : float
        How well the logarithm of the phase is known before the higher orders of the rate say more.
    """

    phase_rad_per_dps: float
    sine_dps: Floats = field(repr=False)
    by_phase: Floats = field(repr=False)
    spread: float

    @property
    def component(self) -> Component:
        """What is not known of it, in units of `spread`."""
        return Component(PHASE, self.spread * self.by_phase, held=1.0)


@dataclass(frozen=True, eq=False)
class Law:
    """A law of the catalogue at some shape, as columns of the model.

    Attributes
    ----------
    columns : ndarray, shape (n, q)
        At unit amplitude, at the rows of the means.
    from_end : bool
        Whether a law of time counts from a state of the record that the surface has, instead of its beginning.
    spread : float
        By which its one shape scatters, or how long a step takes, s.
    mixture : tuple of (float, float)
        Values of its one shape and their weights, where it scatters.
    """

    effect: str
    shape: Mapping[str, float]
    columns: Floats = field(repr=False)
    from_end: bool = False
    spread: float = 0.0
    mixture: tuple[tuple[float, float], ...] = ()

    @property
    def name(self) -> str:
        """Name of its component."""
        return f"{self.effect} {sorted(self.shape.items())}" + (f" +- {self.spread}" if self.spread else "")

    @property
    def members(self) -> list[tuple[Mapping[str, float], float]]:
        """Shapes that it is a sum of, with their weights."""
        if not self.mixture:
            return [(self.shape, 1.0)]
        (name,) = self.shape.keys() - {"of_scale"}
        return [({**self.shape, name: value}, weight) for value, weight in self.mixture]

    @property
    def goes_by_rate(self) -> bool:
        """Whether it acts on the scale factor or on an order of the rate, and not on the bias alone."""
        return "rate_dps" in CATALOGUE[self.effect].needs or bool(self.shape.get("of_scale"))


@dataclass(frozen=True)
class Model:
    """What is in the model of a recording.

    Attributes
    ----------
    design : ndarray, shape (n, 12)
        Surface at the rows (of the coil's temperature, where that is in the model), over the output where it is one
        of the output.
    parts : tuple of Part
        What stays, the surface's own terms included.
    components : mapping
        Name to component: those of the parts, noise, and what passes.
    laws : tuple of Law
    flat : tuple of int
        Terms of the surface that are free: those of `FLAT` that the record carries.
    direction : str
        Whether the surface is one of the ``input`` or of the ``output``, or ``free``: a part of the model.
    bend : ndarray, shape (12,), optional
        Where it is not one of the input: coefficients of the surface over the output, of Legendre products, from which
        the output of a gyro with the surface alone is known.
    law_variance : float
        Prior variance of what a law adds beyond the surface's free terms, for a scan of shapes.
    open_loop : OpenLoop, optional
        A sine that is in the output for certain.
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
    open_loop: OpenLoop | None = None

    @property
    def error_dps(self) -> Floats:
        """What the model is of: gyro minus reference, beside the sine of an open loop."""
        return self.means.error_dps - (0.0 if self.open_loop is None else self.open_loop.sine_dps)

    @property
    def shrunk(self) -> Part | None:
        """The terms of the surface that are not free; None where rates and temperatures are too few for any."""
        return next((p for p in self.parts if p.block == "surface"), None)

    def directed(self, direction: str, bend: Floats) -> Model:
        """The same with a surface of this direction.

        Parameters
        ----------
        bend : coefficients of the surface over the output as far as they are known
        """
        moved = np.zeros_like(self.design)
        if self.direction == "output" and self.bend is not None:
            moved -= beyond_input(self.basis, self.bend)
        if direction == "output":
            moved += beyond_input(self.basis, bend)
        found = self.with_surface_moved(moved)
        components = {n: c for n, c in found.components.items() if n != DIRECTION}
        if direction == "free":
            components[DIRECTION] = Component(DIRECTION, (beyond_input(self.basis, bend) @ bend)[:, None])
        return replace(found, components=components, direction=direction, bend=bend)

    def with_surface_moved(self, moved: Floats) -> Model:
        """The same with other terms of the surface: `moved` is the difference, shape (n, 12)."""
        if not moved.any():
            return self
        components = dict(self.components)
        part = self.shrunk
        own = None if part is None else components.get(part.name)
        if part is not None and own is not None and own.columns is not None:
            shift = moved[:, [SURFACE.index(c) for c in part.columns]] * np.array(part.weights)
            components[part.name] = replace(own, columns=own.columns + shift)
        return replace(self, design=self.design + moved, components=components)

    def bend_of(self, solution: Solution) -> Floats:
        """Coefficients of the surface over the output, of Legendre products, shape (12,).

        A surface over the input is none over the output, but is near to one.
        """
        found = self.legendre(solution)
        if self.direction == "output":
            return found
        error_dps, here = self.design @ found, self.means
        between = self.components[DIRECTION].columns if DIRECTION in solution.amplitudes else None
        if between is not None:
            error_dps = error_dps + between @ solution.amplitudes[DIRECTION]
        at_output = design_at(here.rate_dps + error_dps, here.temp_c, self.basis.frame)
        return np.asarray(np.linalg.lstsq(at_output, error_dps, rcond=1e-12)[0])

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
        own |= {DIRECTION: ODD, **PASSING}
        return {n: b for n, b in own.items() if n in self.components}

    def of_block(self, *blocks: str) -> list[str]:
        """Components of some blocks."""
        return [n for n, b in self.blocks.items() if b in blocks]

    @property
    def all(self) -> list[Component]:
        """Every component, laws included."""
        return [*self.components.values(), *(self.law_component(law) for law in self.laws)]

    def law_component(self, law: Law) -> Component:
        """A law, whose variance is estimated as that of a smooth part is, so that the two can be compared."""
        return Component(law.name, law.columns)

    def with_parts(self, parts: Sequence[Part]) -> Model:
        """The same with further parts that stay."""
        more = [self.basis.component(p) for p in parts]
        return replace(self.with_components(*more), parts=(*self.parts, *parts))

    def with_components(self, *more: Component) -> Model:
        """The same with further components, or with others in the place of those of their names."""
        return replace(self, components={**self.components, **{c.name: c for c in more}})

    def without(self, names: Sequence[str]) -> Model:
        """The same less some components."""
        return replace(self, components={n: c for n, c in self.components.items() if n not in names})

    def holds(self, law: Law) -> bool:
        """Whether it has the law, at that shape."""
        return any(own.name == law.name for own in self.laws)

    def with_laws(self, *more: Law) -> Model:
        """The same with further laws."""
        return replace(self, laws=(*self.laws, *more))

    def without_laws(self, names: Sequence[str]) -> Model:
        """The same less some laws."""
        return replace(self, laws=tuple(law for law in self.laws if law.name not in names))

    def alive(self, fit: Fit) -> Model:
        """The same less what has died."""
        # The surface's own terms may come back when what took their place is gone.
        kept = {"white", *(p.name for p in self.parts if p.block == "surface")}
        dead = [n for n in self.components if n not in kept and _has_died(fit, n)]
        return self.without(dead)


def _has_died(fit: Fit, name: str) -> bool:
    """Whether a component adds nothing; one that was not fitted may."""
    return fit.log_variance.get(name, 0.0) < _DEAD


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

    @cached_property
    def granting_noise(self) -> Fitted:
        """The same with noise that seems to be none as large as it may be expected: what intervals have to allow for."""
        m = self.model
        parts = {*(p.name for p in m.parts), *(law.name for law in m.laws), DIRECTION}
        names = [c.name for c in m.all if c.name not in parts and c.held is None and self.has_died(c.name)]
        logs = self.contrasts.expected(m.all, self.fit.log_variance, names)
        return replace(
            self, fit=replace(self.fit, log_variance=logs, variance=self.contrasts.variances(m.all, logs))
        )

    def has_died(self, name: str) -> bool:
        """Whether a component adds nothing."""
        return _has_died(self.fit, name)

    def refit(self, model: Model, start: Mapping[str, float] | None = None) -> Fitted:
        """Another model of the same record, from these variances or from others (logarithms)."""
        same = model.design is self.model.design and model.open_loop is self.model.open_loop
        contrasts = self.contrasts if same else contrasts_of(model, self.contrasts)
        return Fitted(model, contrasts.fit(model.all, start or self.fit.log_variance), contrasts)


def contrasts_of(model: Model, like: Contrasts | None = None, designs: Sequence[Floats] = ()) -> Contrasts:
    """The record freed of the surface's free terms.

    Parameters
    ----------
    like : those of another model that it is compared with
    designs : surfaces of models that will be compared with it, shape (n, 12) each
    """
    flat = model.design[:, model.flat]
    if like is not None:
        return Contrasts(model.error_dps, flat, like=like)
    columns = [c.columns for c in model.components.values() if c.columns is not None]
    steps = np.tri(len(model.means))[:, :: max(1, len(model.means) // _STEPS)]
    u = model.means.rate_dps / model.basis.frame.rate_scale_dps
    span = np.concatenate([*columns, steps, steps * u[:, None]], axis=1)
    rough = np.asarray(np.linalg.lstsq(model.design, model.error_dps, rcond=1e-12)[0], dtype=np.float64)
    whole = np.concatenate([model.design, beyond_input(model.basis, rough), *designs], axis=1)
    return Contrasts(model.error_dps, flat, span, whole)


def free_terms(series: Series) -> tuple[int, ...]:
    """Coefficients of the surface that nothing shrinks, of those that a record can tell apart."""
    carried = carried_terms(series)
    return tuple(k for k in FLAT if k in carried)


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
    # At one temperature the slope along what scatters in it could be anything, a drift's in time too.
    rough = np.zeros(len(SURFACE))
    rough[carried] = np.linalg.lstsq(design[:, carried], means.error_dps, rcond=None)[0]
    left = means.error_dps - design @ rough
    components |= {c.name: c for c in of_thermometer(means, basis.frame, rough)}
    components |= {c.name: c for c in (*of_steps(means, design, rough), *standing(means))} if memory else {}
    wide = _WIDE * float(np.mean(left**2))
    return Model(means, basis, design, parts, components, law_variance=wide, flat=free_terms(means.series))


def of_thermometer(means: Means, frame: Frame, surface: Floats) -> list[Component]:
    """What is not known of the temperature, through the slope of the surface: known noise; none where it is known.

    Parameters
    ----------
    surface : its coefficients, of Legendre products, shape (12,)
    """
    unknown = means.series.history.covariance_at(means.t_s)
    if unknown is None:
        return []
    slope = slope_by_temperature(means.rate_dps, means.temp_c, frame, surface)
    return [Component(THERMOMETER, covariance=slope[:, None] * unknown * slope, held=1.0)]


def of_steps(means: Means, design: Floats, surface: Floats) -> list[Component]:
    """What rounding leaves in means of samples, which follows the output from step to step; none where there are no steps.

    Parameters
    ----------
    design, surface : terms, shape (n, 12), and their coefficients as far as they are known, shape (12,)
    """
    raw = means.series.raw
    step, scatter_dps = raw.lattice_dps, raw.sample_std_dps
    if step is None or scatter_dps is None:
        return []
    sizes_dps = [harmonic(step, scatter_dps, k + 1) for k in range(_HARMONICS)]
    sizes_dps = [size for size in sizes_dps if size >= _FINE * scatter_dps]
    if not sizes_dps:
        return []
    for _ in range(_PHASES):
        phase = 2.0 * np.pi * (means.rate_dps + design @ surface) / step
        both = np.column_stack([design, np.sin(phase), np.cos(phase)])
        surface = np.linalg.lstsq(both, means.error_dps, rcond=1e-12)[0][: len(surface)]
    waves = [size * f((k + 1) * phase) for k, size in enumerate(sizes_dps) for f in (np.sin, np.cos)]
    return [Component(ROUNDING, np.column_stack(waves), held=0.5)]


def standing(means: Means) -> list[Component]:
    """What rounding leaves in segments whose samples scatter by less than those of the data sets: one error for each step of the output."""
    raw, own_dps = means.series.raw, means.series.scatter_dps
    step, scatter_dps = raw.lattice_dps, raw.sample_std_dps
    if step is None or scatter_dps is None or own_dps is None:
        return []
    scatters, segment = np.unique(means.spread(own_dps), return_inverse=True)
    usual = mean_error_std(step, scatter_dps)
    variance = np.array([max(mean_error_std(step, one) ** 2 - usual**2, 0.0) for one in scatters])
    # Nobody says whether the output is rounded or cut, which is off by up to a whole step.
    off_dps = 2.0 * np.sqrt(variance)[segment]
    if not np.any(off_dps > _FINE * scatter_dps):
        return []
    apart = np.abs(means.gyro_dps[:, None] - means.gyro_dps) / step
    # While it stands the output goes from one end of its step to the other, or stays anywhere between.
    alike = _STANDING_ALIKE * np.maximum(1.0 - apart, 0.0) + (1.0 - _STANDING_ALIKE) * np.eye(off_dps.size)
    covariance = off_dps[:, None] * alike * off_dps
    return [Component(STANDING, covariance=covariance, held=1.0)]


def lagging(rows: Basis) -> Floats:
    """What the terms of the surface gain by the lag of the coil, shape (n, 12)."""
    return rows.surface() - replace(rows, coil=None).surface()


def beyond_input(rows: Basis, bend: Floats) -> Floats:
    """The terms of a surface over the output, less those of one over the input, shape (n, 12).

    The output is that of a gyro with the surface alone, to which effects are added, as a robot takes it.
    """
    here, frame = rows.means, rows.frame
    output_dps = here.rate_dps
    for _ in range(ROUNDS):
        error_dps = design_at(output_dps, here.temp_c, frame) @ bend
        # A surface that is not known yet may be as steep as no gyro's.
        output_dps = here.rate_dps + np.clip(error_dps, -frame.rate_scale_dps, frame.rate_scale_dps)
    at_input = design_at(here.rate_dps, here.temp_c, frame)
    return design_at(output_dps, here.temp_c, frame) - at_input


def fit_model(model: Model, start: Mapping[str, float] | None = None) -> Fitted:
    """Variances of a model."""
    contrasts = contrasts_of(model)
    return Fitted(model, contrasts.fit(model.all, start), contrasts)


def surface_of(model: Model, solution: Solution) -> Surface:
    """The surface of a model, over the input rate."""
    frame = model.basis.frame
    powers = (legendre_to_powers() @ model.legendre(solution)).reshape(SHAPE)
    return Surface(powers, 0.0, frame.rate_scale_dps, frame.temp_center_c, frame.temp_scale_c, "input")
