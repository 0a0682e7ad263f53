"""Surface and named physics fitted together: parameters with intervals, and the improved coefficient file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.analysis import Analysis
from gyrocal.diagnosis.base import Base, simulate, with_coefficients
from gyrocal.diagnosis.columns import conditions_of
from gyrocal.diagnosis.gate import Gate
from gyrocal.diagnosis.hypotheses import columns_at
from gyrocal.diagnosis.intervals import Profile, amplitude_interval, descend, profile_interval
from gyrocal.diagnosis.result import Estimate
from gyrocal.diagnosis.search import Member
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.effect import Conditions
from gyrocal.physics.surface import Surface

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Shape parameters that are refined between the points of the grid; the others are what the grid says.
_REFINED = {
    "shupe_gradient": ("tau_s",),
    "thermal_lag": ("tau_s",),
    "thermal_hysteresis": ("width_c",),
    "warm_up": ("tau_s",),
    "bias_step": ("at_s",),
    "scale_step": ("at_s",),
    "sagnac_sine": ("phase_rad_per_dps",),
    "saturation": ("knee_dps",),
    "mechanical_resonance": ("center_dps", "width_dps"),
    "step_response": ("tau_s", "frequency_hz"),
}
#: Shape parameters that help the search and are not in the catalogue's law. (``of_output`` is: the runtime has
#: the output that is cut.)
_SEARCH_ONLY = ("softness_dps",)
_NORMAL_95 = 1.959964
#: Ends of turns on either side of a change of scale factor at which it may have been.
_TURNS_AROUND = 8


@dataclass(frozen=True)
class Piece:
    """A member of the model with its refined shape.

    Attributes
    ----------
    columns : ndarray, shape (n, k)
        At unit amplitude, deg/s.
    """

    member: Member
    shape: Mapping[str, float]
    columns: Floats


@dataclass(frozen=True)
class Solved:
    """A surface fitted beside some pieces.

    Attributes
    ----------
    surface : Surface
    covariance_dps2 : ndarray, shape (12, 12)
    left_dps : ndarray, shape (n,)
        What surface and pieces leave of the record.
    """

    surface: Surface
    covariance_dps2: Floats
    left_dps: Floats


@dataclass(frozen=True)
class Refined:
    """The surface alone, with the named physics, and with all that was found.

    Patterns without a name take part in the estimates of what is named, so that these are not bent by them, but
    in nothing that is to be used: a surface that was fitted beside a pattern is wrong without it.

    Attributes
    ----------
    plain, named, whole : Solved
        Surface alone; with named pieces; with all members.
    pieces : tuple of Piece
        Named.
    parameters : mapping
        Effect id to its parameters, estimated beside all members.
    file_parameters : mapping
        The same as they stand beside the surface of `named`, for use with it.
    effects_dps : mapping
        What each named effect adds, in `named`.
    joint : mapping
        Effect and parameter that a robot evaluates to its covariance with the twelve coefficients of the surface
        and with all parameters of this mapping, in its order.
    """

    plain: Solved
    named: Solved
    whole: Solved
    pieces: tuple[Piece, ...]
    parameters: Mapping[str, Mapping[str, Estimate]]
    file_parameters: Mapping[str, Mapping[str, Estimate]]
    effects_dps: Mapping[str, Floats]
    joint: Mapping[tuple[str, str], Sequence[float]]


@dataclass
class _Fit:
    """Generalised least squares with law columns that change; surface columns are whitened once."""

    analysis: Analysis
    base: Base
    white_base: Floats = field(init=False)

    def __post_init__(self) -> None:
        columns = np.column_stack([self.base.residual_dps, self.base.design])
        self.white_base = self.whiten(columns)
        self._q = np.linalg.qr(self.white_base[:, 1:])[0]

    def whiten(self, columns: Floats) -> Floats:
        return self.analysis.setup.model.whiten(self.analysis.levels, columns)[0]

    def rss(self, columns: Floats) -> float:
        """Residual sum of squares with some columns beside the surface's."""
        y = self.white_base[:, 0]
        both = np.column_stack([y, self.whiten(columns)]) if columns.size else y[:, None]
        both = both - self._q @ (self._q.T @ both)
        if both.shape[1] == 1:
            return float(both[:, 0] @ both[:, 0])
        solution = np.linalg.lstsq(both[:, 1:], both[:, 0], rcond=1e-9)[0]
        left = both[:, 0] - both[:, 1:] @ solution
        return float(left @ left)

    def one(self, column: Floats, others: Floats) -> tuple[float, float, float]:
        """Residual sum of squares, amplitude and its standard deviation of one column beside others, shape (n, k)."""
        white = np.column_stack([self.white_base[:, 0], self.whiten(np.column_stack([column, others]))])
        white -= self._q @ (self._q.T @ white)
        y, own = white[:, 0], white[:, 1]
        if others.shape[1]:
            y, own = (
                white[:, :2] - white[:, 2:] @ np.linalg.lstsq(white[:, 2:], white[:, :2], rcond=1e-9)[0]
            ).T
        norm2 = float(own @ own)
        if norm2 == 0.0:
            # A shape that no row shows: a knee above all rates.
            return float(y @ y), 0.0, float("inf")
        amplitude = float(own @ y) / norm2
        return float(y @ y) - amplitude**2 * norm2, amplitude, 1.0 / float(np.sqrt(norm2))

    def solve(self, columns: Floats) -> tuple[Floats, Floats]:
        """Coefficients of surface and columns, and their covariance."""
        X = self.white_base[:, 1:]
        if columns.size:
            X = np.column_stack([X, self.whiten(columns)])
        scale = np.linalg.norm(X, axis=0)
        scale[scale == 0] = 1.0
        left, values, right = np.linalg.svd(X / scale, full_matrices=False)
        inverse = np.where(values > 1e-11 * values[0], 1.0 / np.maximum(values, 1e-300), 0.0)
        half = right.T * inverse
        coefficients = half @ (left.T @ self.white_base[:, 0])
        return coefficients / scale, half @ half.T / np.outer(scale, scale)


def member_columns(
    member: Member, shape: Mapping[str, float], c: Conditions, surface: Surface, grid: Floats
) -> Floats:
    """Columns of a member at a shape: the catalogue's law, or what the search used where there is none."""
    h = member.hypothesis
    return grid[:, member.columns] if not h.in_catalogue or h.random else columns_at(h, c, shape, surface)


def refine(analysis: Analysis, decided: Gate) -> Refined:
    """Fit surface and members together, shapes included."""
    c = conditions_of(analysis.setup.series)
    members = [*decided.named, *decided.withheld]
    pieces, profiles = _refine_shapes(analysis, members, c, _Fit(analysis, analysis.setup.base))
    named = pieces[: len(decided.named)]
    plain = _beside(analysis, [], profiles, c)
    own = _beside(analysis, named, profiles, c)
    whole = _beside(analysis, pieces, profiles, c) if decided.withheld else own
    return Refined(
        plain.solved,
        own.solved,
        whole.solved,
        tuple(named),
        {p.member.hypothesis.id: _estimates(analysis, p, *whole.of(p), profiles) for p in named},
        {p.member.hypothesis.id: _estimates(analysis, p, *own.of(p), profiles) for p in named},
        {p.member.hypothesis.id: p.columns @ own.of(p)[0] for p in named},
        _joint(named, own.covariance, own.steps, analysis.setup.base.terms),
    )


@dataclass(frozen=True)
class _Beside:
    """A joint fit: what is left, and all linear coefficients with those of the shapes' tangents last."""

    solved: Solved
    solution: Floats
    covariance: Floats
    rows: Mapping[int, Ints]
    steps: Mapping[tuple[str, str], float]

    def of(self, piece: Piece) -> tuple[Floats, Floats]:
        """Amplitudes of a piece and their covariance."""
        rows = self.rows[id(piece)]
        return self.solution[rows], self.covariance[np.ix_(rows, rows)]


def _beside(
    analysis: Analysis,
    pieces: Sequence[Piece],
    profiles: Mapping[tuple[str, str], Profile],
    c: Conditions,
) -> _Beside:
    series, base = analysis.setup.series, analysis.setup.base
    stacked = np.concatenate([np.empty((len(series), 0)), *(p.columns for p in pieces)], axis=1)
    fit = _Fit(analysis, base)
    for _ in range(3 if pieces else 1):
        # The surface is a function of the output itself: it is linearised anew around its own fit.
        base = simulate(series, _moved(base, fit.solve(stacked)[0]), base.terms)
        fit = _Fit(analysis, base)
    solution, _ = fit.solve(stacked)
    covariance, steps = _with_shapes(fit, pieces, profiles, stacked, solution, c)
    p = base.design.shape[1]
    rows, first = {}, p
    for piece in pieces:
        rows[id(piece)] = np.arange(first, first + piece.columns.shape[1])
        first += piece.columns.shape[1]
    left = base.residual_dps - base.design @ solution[:p] - stacked @ solution[p:]
    solved = Solved(_moved(base, solution), _full(covariance[:p, :p], base.terms), left)
    return _Beside(solved, solution, covariance, rows, steps)


def _moved(base: Base, solution: Floats) -> Surface:
    known = base.surface.coefficients_dps.ravel()[base.terms]
    return with_coefficients(base.surface, base.terms, known + solution[: base.terms.size])


def _full(covariance: Floats, terms: Ints) -> Floats:
    full = np.zeros((12, 12))
    full[np.ix_(terms, terms)] = covariance
    return full


def _refine_shapes(
    analysis: Analysis, members: Sequence[Member], c: Conditions, fit: _Fit
) -> tuple[list[Piece], dict[tuple[str, str], Profile]]:
    """Shapes between the points of the grid, one parameter at a time, and profile intervals of them."""
    surface, grid = analysis.setup.base.surface, analysis.setup.columns
    shapes = [_of_catalogue(m) for m in members]

    def columns_of(k: int) -> Floats:
        return member_columns(members[k], shapes[k], c, surface, grid)

    columns = [columns_of(k) for k in range(len(members))]
    handles = []
    for k, member in enumerate(members):
        if not member.hypothesis.in_catalogue:
            continue
        names = _REFINED.get(member.hypothesis.id, ())
        handles += [(k, name, _reach(member, name)) for name in names if shapes[k].get(name, 0.0) != 0.0]

    def loss(k: int, name: str, value: float) -> float:
        shape = {**shapes[k], name: value}
        trial = member_columns(members[k], shape, c, surface, grid)
        rest = [columns[i] if i != k else trial for i in range(len(members))]
        return fit.rss(np.concatenate(rest, axis=1))

    profiles: dict[tuple[str, str], Profile] = {}
    for sweep in range(3 if len(handles) > 1 else 1):
        for k, name, reach in handles:
            shapes[k][name] = descend(
                lambda value, k=k, name=name: loss(k, name, value),  # type: ignore[misc]
                shapes[k][name],
                reach,
                candidates=_instants_near(analysis, members[k].hypothesis.id, shapes[k][name])
                if name == "at_s"
                else None,
            )
            columns[k] = columns_of(k)
        if sweep and len(handles) <= 1:
            break
    for k, name, reach in handles:
        limits = _limits(members[k].hypothesis.id, name)
        profiles[members[k].hypothesis.id, name] = profile_interval(
            lambda value, k=k, name=name: loss(k, name, value),  # type: ignore[misc]
            shapes[k][name],
            reach,
            limits,
            candidates=_instants_near(analysis, members[k].hypothesis.id, shapes[k][name])
            if name == "at_s"
            else None,
        )
    for k, member in enumerate(members):
        mine = [name for i, name, _ in handles if i == k and name != "at_s"]
        if len(mine) == 1 and columns[k].shape[1] == 1:
            others = np.concatenate(
                [np.empty((columns[k].shape[0], 0)), *(x for i, x in enumerate(columns) if i != k)], axis=1
            )
            effect = member.hypothesis.id

            def at(
                value: float, k: int = k, name: str = mine[0], others: Floats = others
            ) -> tuple[float, float, float]:
                trial = member_columns(members[k], {**shapes[k], name: value}, c, surface, grid)
                return fit.one(trial, others)

            profiles[effect, "amplitude"] = amplitude_interval(
                at, profiles[effect, mine[0]].interval, _limits(effect, mine[0])
            )
    pieces = [Piece(m, s, x) for m, s, x in zip(members, shapes, columns, strict=True)]
    return pieces, profiles


def _of_catalogue(member: Member) -> dict[str, float]:
    """Shape of a member in the parameters of the catalogue, which the runtime evaluates: no softened knees."""
    return {k: v for k, v in member.hypothesis.shapes[member.point].items() if k not in _SEARCH_ONLY}


def _reach(member: Member, name: str) -> float:
    """Ratio between neighbours on the grid of a shape parameter."""
    values = np.unique([s[name] for s in member.hypothesis.shapes if name in s])
    values = values[values > 0]
    if values.size < 2:
        return 2.0
    return float(np.clip(np.max(values[1:] / values[:-1]), 1.02, 3.0))


def _limits(effect: str, name: str) -> tuple[float, float]:
    found = next(p for p in CATALOGUE[effect].parameters if p.name == name)
    return found.low, found.high


def _instants_near(analysis: Analysis, effect: str, at_s: float) -> Floats:
    """Instants around a candidate: whole seconds near by, wider steps farther off.

    A change of scale factor shows only while the table turns: before and after the turns on either side as well.
    """
    series = analysis.setup.series
    near = np.concatenate(
        [np.arange(0.0, 12.1, 0.5), np.arange(16.0, 61.0, 8.0), np.arange(90.0, 601.0, 60.0)]
    )
    found = [at_s - near, at_s + near]
    if effect == "scale_step":
        turning = np.flatnonzero(series.rate_dps != 0)
        last = np.flatnonzero(np.diff(series.set_index[turning]))
        ends, starts = turning[last], turning[last + 1]
        edges = np.sort(
            np.concatenate(
                [
                    series.t_s[ends] + 0.5 * series.averaging_s[ends],
                    series.t_s[starts] - 0.5 * series.averaging_s[starts],
                ]
            )
        )
        place = int(np.searchsorted(edges, at_s))
        found.append(edges[max(place - _TURNS_AROUND, 0) : place + _TURNS_AROUND])
    found_s = np.unique(np.concatenate(found))
    return np.asarray(found_s[(found_s > series.t_s[0]) & (found_s < series.t_s[-1])])


def _with_shapes(
    fit: _Fit,
    pieces: Sequence[Piece],
    profiles: Mapping[tuple[str, str], Profile],
    stacked: Floats,
    solution: Floats,
    c: Conditions,
) -> tuple[Floats, dict[tuple[str, str], float]]:
    """Covariance of all linear coefficients with the uncertainty of the shapes: their tangents are columns too.

    The second part names the tangents, which stand last, with the change of the parameter that each is for.
    """
    first = fit.base.design.shape[1]
    tangents, steps = [], {}
    for piece in pieces:
        rows = np.arange(first, first + piece.columns.shape[1])
        first += rows.size
        for name in _REFINED.get(piece.member.hypothesis.id, ()):
            if (piece.member.hypothesis.id, name) not in profiles or name == "at_s":
                continue
            value = piece.shape[name]
            ahead = member_columns(
                piece.member, {**piece.shape, name: 1.02 * value}, c, fit.base.surface, stacked
            )
            tangents.append((ahead - piece.columns) @ solution[rows])
            steps[piece.member.hypothesis.id, name] = 0.02 * value
    extended = np.column_stack([stacked, *tangents]) if tangents else stacked
    _, covariance = fit.solve(extended)
    return covariance, steps


def _joint(
    named: Sequence[Piece], covariance: Floats, steps: Mapping[tuple[str, str], float], terms: Ints
) -> dict[tuple[str, str], list[float]]:
    """Rows of `Refined.joint`: terms in the order of the file, their parameters sorted by name."""
    at: dict[tuple[str, str], tuple[int, float]] = {}
    first = terms.size
    last = covariance.shape[0] - len(steps)
    for piece in named:
        effect = piece.member.hypothesis.id
        if CATALOGUE[effect].runtime and piece.columns.shape[1] == 1:
            own = {"amplitude": (first, 1.0)}
            own |= {
                name: (last + k, step) for k, ((e, name), step) in enumerate(steps.items()) if e == effect
            }
            at |= {(effect, name): own[name] for name in sorted(own)}
        first += piece.columns.shape[1]
    rows = np.array([row for row, _ in at.values()], dtype=np.int64)
    scale = np.array([step for _, step in at.values()])
    found = np.zeros((rows.size, 12 + rows.size))
    found[:, terms] = covariance[rows][:, : terms.size] * scale[:, None]
    found[:, 12:] = covariance[np.ix_(rows, rows)] * np.outer(scale, scale)
    return dict(zip(at, found.tolist(), strict=True))


def _estimates(
    analysis: Analysis,
    piece: Piece,
    values: Floats,
    covariance: Floats,
    profiles: Mapping[tuple[str, str], Profile],
) -> dict[str, Estimate]:
    """Parameters of an effect in the catalogue's units."""
    h = piece.member.hypothesis
    units = {p.name: p.unit for p in CATALOGUE[h.id].parameters}
    if h.random:
        return {"amplitude": _draw_size(analysis, h.points[0], units["amplitude"])}
    found: dict[str, Estimate] = {}
    if h.id == "rate_order" and values.size == 2:
        amplitude, std = float(values[0]), float(np.sqrt(covariance[0, 0]))
        found["amplitude_2"] = _normal(float(values[1]), float(np.sqrt(covariance[1, 1])), units["amplitude"])
        units["order_2"] = units["order"]
    elif values.size == 2:
        amplitude = float(np.hypot(*values))
        gradient = values / amplitude
        std = float(np.sqrt(gradient @ covariance @ gradient))
        across = np.array([values[1], -values[0]]) / amplitude**2
        phase_std = float(np.sqrt(across @ covariance @ across))
        phase = float(np.arctan2(-values[1], values[0]))
        found["phase_rad"] = _normal(phase, phase_std, "rad")
    else:
        amplitude, std = float(values[0]), float(np.sqrt(covariance[0, 0]))
    for name, value in piece.shape.items():
        if name not in units:
            continue
        profile = profiles.get((h.id, name))
        found[name] = (
            Estimate(value, 0.0, units[name], (value, value))
            if profile is None
            else Estimate(value, profile.std, units[name], profile.interval)
        )
    traded = profiles.get((h.id, "amplitude"))
    if traded is not None and traded.interval[0] < amplitude < traded.interval[1]:
        own = Estimate(amplitude, traded.std, units["amplitude"], traded.interval)
    else:
        own = _normal(amplitude, std, units["amplitude"])
    return {"amplitude": own} | found


def _normal(value: float, std: float, unit: str) -> Estimate:
    return Estimate(value, std, unit, (value - _NORMAL_95 * std, value + _NORMAL_95 * std))


def _draw_size(analysis: Analysis, columns: Ints, unit: str) -> Estimate:
    """Size of independent draws of which a block of amplitudes is made: marginal likelihood over its net."""
    others = [m for m in analysis.members if not m.hypothesis.random]
    rest = analysis.search.given(others)
    A, b = rest.gram[np.ix_(columns, columns)], rest.score[columns]
    lam, vectors = np.linalg.eigh(A)
    kept = lam > 1e-6 * lam[-1]
    along = (vectors[:, kept].T @ b) ** 2
    lam = lam[kept]
    size = np.geomspace(0.1, 1e5, 2000)
    s2 = size[:, None] ** 2
    logl = np.sum(0.5 * along * s2 / (1 + s2 * lam) - 0.5 * np.log1p(s2 * lam), axis=1)
    best = int(np.argmax(logl))
    inside = size[logl > logl[best] - 1.92]
    std = float(size[best] / np.sqrt(2.0 * max(lam.size, 1)))
    return Estimate(float(size[best]), std, unit, (float(inside[0]), float(inside[-1])))
