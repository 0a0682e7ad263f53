"""Surface and named physics fitted together: parameters with intervals, and the improved coefficient file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.analysis import Analysis
from gyrocal.diagnosis.base import Base, fit_surface, raised, simulate, with_coefficients
from gyrocal.diagnosis.columns import conditions_of
from gyrocal.diagnosis.gate import Gate
from gyrocal.diagnosis.intervals import NORMAL_95, Profile
from gyrocal.diagnosis.result import Estimate
from gyrocal.diagnosis.series import Series
from gyrocal.diagnosis.shapes import REFINED, JointFit, Piece, member_columns, refine_shapes
from gyrocal.diagnosis.whitening import NoiseLevels
from gyrocal.errors import DataError
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.effect import Conditions
from gyrocal.physics.surface import Surface

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


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


def refine(analysis: Analysis, decided: Gate) -> Refined:
    """Fit surface and members together, shapes included."""
    c = conditions_of(analysis.setup.series)
    members = [*decided.named, *decided.withheld]
    pieces, profiles = refine_shapes(analysis, members, c, JointFit(analysis, analysis.setup.base))
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
    series = analysis.setup.series
    # The search may have linearised around a surface that is right beside a law, and far off without it.
    base = analysis.setup.base if pieces else fit_surface(series)
    stacked = np.concatenate([np.empty((len(series), 0)), *(p.columns for p in pieces)], axis=1)
    fit = JointFit(analysis, base)
    held = False
    for _ in range(3 if pieces else 1):
        # The surface is a function of the output itself: it is linearised anew around its own fit.
        try:
            base = simulate(series, _moved(base, fit.solve(stacked)[0]), base.terms)
        except DataError:
            # A step too far: no gyro is like that. The surface stays where it was linearised.
            held = True
            break
        fit = JointFit(analysis, base)
    solution, _ = fit.solve(stacked)
    if held:
        solution[: base.terms.size] = 0.0
    covariance, steps = _with_shapes(fit, pieces, profiles, stacked, solution, c)
    p = base.design.shape[1]
    rows, first = {}, p
    for piece in pieces:
        rows[id(piece)] = np.arange(first, first + piece.columns.shape[1])
        first += piece.columns.shape[1]
    left = base.residual_dps - base.design @ solution[:p] - stacked @ solution[p:]
    solved = _centred(
        Solved(_moved(base, solution), _full(covariance[:p, :p], base.terms), left), series, analysis.levels
    )
    return _Beside(solved, solution, covariance, rows, steps)


def _centred(solved: Solved, series: Series, levels: NoiseLevels) -> Solved:
    """Where the bias walks, its level is known for an instant only: the surface takes the mean of the recording.

    The fit itself refers to the first row, from which the walk is counted; the mean of a walk over T is away from
    it by a variance of K^2 T / 3.
    """
    if not levels.walk:
        return solved
    mean_dps = float(
        np.average(solved.left_dps, weights=series.averaging_s if series.averaging_s.any() else None)
    )
    covariance = solved.covariance_dps2.copy()
    covariance[0, 0] += levels.walk**2 * float(np.ptp(series.t_s)) / 3.0
    return Solved(raised(solved.surface, mean_dps), covariance, solved.left_dps - mean_dps)


def _moved(base: Base, solution: Floats) -> Surface:
    known = base.surface.coefficients_dps.ravel()[base.terms]
    return with_coefficients(base.surface, base.terms, known + solution[: base.terms.size])


def _full(covariance: Floats, terms: Ints) -> Floats:
    full = np.zeros((12, 12))
    full[np.ix_(terms, terms)] = covariance
    return full


def _with_shapes(
    fit: JointFit,
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
        for name in REFINED.get(piece.member.hypothesis.id, ()):
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
    return Estimate(value, std, unit, (value - NORMAL_95 * std, value + NORMAL_95 * std))


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
