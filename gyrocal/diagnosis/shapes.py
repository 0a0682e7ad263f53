"""Shapes of what was found, between the points of the search's grids: descent and profile intervals.

Everything here is generalised least squares at the final noise levels; amplitudes are always at their best.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.analysis import Analysis
from gyrocal.diagnosis.base import Base
from gyrocal.diagnosis.hypotheses import columns_at
from gyrocal.diagnosis.intervals import Profile, amplitude_interval, descend, profile_interval
from gyrocal.diagnosis.search import Member
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.effect import Conditions
from gyrocal.physics.surface import Surface

Floats = NDArray[np.float64]

#: Shape parameters that are refined between the points of the grid; the others are what the grid says.
REFINED = {
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


@dataclass
class JointFit:
    """Generalised least squares with law columns that change; surface columns are whitened once."""

    analysis: Analysis
    base: Base
    white_base: Floats = field(init=False)

    def __post_init__(self) -> None:
        columns = np.column_stack([self.base.residual_dps, self.base.design])
        self.white_base = self.whiten(columns)
        self._q = np.linalg.qr(self.white_base[:, 1:])[0]

    def whiten(self, columns: Floats) -> Floats:
        """Whitened columns at the final noise levels."""
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


def refine_shapes(
    analysis: Analysis, members: Sequence[Member], c: Conditions, fit: JointFit
) -> tuple[list[Piece], dict[tuple[str, str], Profile]]:
    """Shapes between the points of the grid, one parameter at a time, and profile intervals of them."""
    state = _Shapes(analysis, members, c, fit)
    for _ in range(3 if len(state.handles) > 1 else 1):
        state.descend()
    pieces = [Piece(m, s, x) for m, s, x in zip(members, state.shapes, state.columns, strict=True)]
    return pieces, state.profiles()


class _Shapes:
    """The members' shapes and columns while they are refined in turn."""

    def __init__(self, analysis: Analysis, members: Sequence[Member], c: Conditions, fit: JointFit) -> None:
        self.analysis, self.members, self.fit = analysis, members, fit
        self._c = c
        self.shapes = [_of_catalogue(m) for m in members]
        self.columns = [self._columns(k, shape) for k, shape in enumerate(self.shapes)]
        self.handles = [
            (k, name)
            for k, member in enumerate(members)
            if member.hypothesis.in_catalogue
            for name in REFINED.get(member.hypothesis.id, ())
            if self.shapes[k].get(name, 0.0) != 0.0
        ]

    def _columns(self, k: int, shape: Mapping[str, float]) -> Floats:
        setup = self.analysis.setup
        return member_columns(self.members[k], shape, self._c, setup.base.surface, setup.columns)

    def _others(self, k: int) -> Floats:
        blank = np.empty((len(self.analysis.setup.series), 0))
        return np.concatenate([blank, *(x for i, x in enumerate(self.columns) if i != k)], axis=1)

    def _loss(self, k: int, name: str, value: float) -> float:
        trial = self._columns(k, {**self.shapes[k], name: value})
        return self.fit.rss(np.concatenate([trial, self._others(k)], axis=1))

    def _candidates(self, k: int, name: str) -> Floats | None:
        if name != "at_s":
            return None
        return _instants_near(self.analysis, self.members[k].hypothesis.id, self.shapes[k][name])

    def descend(self) -> None:
        """Move each parameter to the least loss, given the others."""
        for k, name in self.handles:
            self.shapes[k][name] = descend(
                lambda value, k=k, name=name: self._loss(k, name, value),  # type: ignore[misc]
                self.shapes[k][name],
                _reach(self.members[k], name),
                candidates=self._candidates(k, name),
            )
            self.columns[k] = self._columns(k, self.shapes[k])

    def profiles(self) -> dict[tuple[str, str], Profile]:
        """Interval of each parameter, and of amplitudes that are traded against one."""
        found = {}
        for k, name in self.handles:
            effect = self.members[k].hypothesis.id
            found[effect, name] = profile_interval(
                lambda value, k=k, name=name: self._loss(k, name, value),  # type: ignore[misc]
                self.shapes[k][name],
                _reach(self.members[k], name),
                _limits(effect, name),
                candidates=self._candidates(k, name),
            )
            alone = sum(i == k for i, _ in self.handles) == 1
            if alone and name != "at_s" and self.columns[k].shape[1] == 1:
                found[effect, "amplitude"] = self._amplitude(k, name, found[effect, name])
        return found

    def _amplitude(self, k: int, name: str, profile: Profile) -> Profile:
        others = self._others(k)

        def at(value: float) -> tuple[float, float, float]:
            return self.fit.one(self._columns(k, {**self.shapes[k], name: value}), others)

        return amplitude_interval(at, profile.interval, _limits(self.members[k].hypothesis.id, name))


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
