"""One linearisation of a path that is laid on a truth: its least squares, and what is left that has no name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import special, stats

from gyrocal.diagnosis.drive.motions import AS_LIKELY
from gyrocal.diagnosis.drive.nameless import is_odd
from gyrocal.diagnosis.drive.path_noise import PathNoise
from gyrocal.diagnosis.drive.path_strangers import ONE_SIZE, SPINNING
from gyrocal.diagnosis.drive.reckoning import Floats
from gyrocal.inference.gls import Levels, Regression, regress, restricted_levels
from gyrocal.inference.newton import descend
from gyrocal.physics.drive import GYRO_SCALE

#: Standard deviation of an amplitude that nothing tells of, in units in which its column has length one.
_UNTOLD = 1e6
#: Levels of the noise are within so many standard deviations of what was thought.
_FAR = 3.0


@dataclass(frozen=True)
class PathProblem:
    """Rows of one linearisation: residual, columns, what is known of each coefficient, noise."""

    residual: Floats
    columns: Mapping[str, Floats]
    known: Mapping[str, tuple[float, float]]
    noise: PathNoise

    @property
    def design(self) -> Floats:
        """All columns, shape (rows, parameters)."""
        return np.column_stack([*self.columns.values()])

    def with_columns(self, more: Mapping[str, Floats]) -> PathProblem:
        """The same with further columns."""
        return replace(self, columns={**self.columns, **more})

    def told(self, name: str, logs: Floats) -> tuple[float, float]:
        """A coefficient and its standard deviation."""
        found, at = self.solve(logs), list(self.columns).index(name)
        return float(found.values[at]), float(np.sqrt(found.covariance[at, at]))

    def left(self, values: Floats) -> Floats:
        """Rows that coefficients leave."""
        return np.asarray(self.residual - self.design @ values)

    def solve(self, logs: Floats) -> Regression:
        """Coefficients under noise of these levels; the loss is infinite where they make none."""
        x, size, mean, std = self._sized
        try:
            found = regress(self.noise.whole(logs), x, self.residual, mean, std)
        except np.linalg.LinAlgError:
            return Regression(np.zeros(x.shape[1]), np.eye(x.shape[1]), np.inf, np.inf)
        return replace(found, values=found.values / size, covariance=found.covariance / np.outer(size, size))

    @cached_property
    def _sized(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Columns of length one, their lengths, and what is known of their coefficients."""
        x = self.design
        size = np.maximum(np.linalg.norm(x, axis=0), 1e-12)
        mean, std = np.array([self.known.get(name, (0.0, np.inf)) for name in self.columns]).T
        return x / size, size, mean * size, np.minimum(std * size, _UNTOLD)

    def likeliest(self, usual: Floats, spread: Floats) -> Floats:
        """Logarithms of the levels of the noise that are likeliest, where they are known to a spread beforehand."""
        x, _, mean, std = self._sized

        def at(logs: Floats) -> Levels:
            parts = self.noise.parts(logs)
            found = restricted_levels(self.noise.gyro, parts, x, self.residual, mean, std)
            away = (logs - usual) / spread
            return Levels(
                found.value + 0.5 * float(away @ away),
                found.slope + away / spread,
                found.bend + np.diag(spread**-2.0),
            )

        bounds = np.column_stack([usual - _FAR * spread, usual + _FAR * spread])
        return descend(at, usual, bounds)[0]


def _gains(
    problem: PathProblem, blocks: Mapping[str, Mapping[str, Floats]], logs: Floats
) -> dict[str, float]:
    """Twice the log likelihood that the columns of each block add."""
    left = problem.solve(logs).left
    return {n: left - problem.with_columns(more).solve(logs).left for n, more in blocks.items()}


def oddities(
    problem: PathProblem, blocks: Mapping[str, Mapping[str, Floats]], logs: Floats
) -> dict[str, float]:
    """Logarithm of the p-value of the columns of each coordinate."""
    return {c: log_chance(gain, len(blocks[c])) for c, gain in _gains(problem, blocks, logs).items()}


def log_chance(gain: float, columns: int) -> float:
    """Logarithm of the chance of a gain, twice a log likelihood; by the leading term where the chance is less than a float holds."""
    exact = float(stats.chi2.logsf(gain, columns))
    half, k = 0.5 * gain, 0.5 * columns
    return exact if np.isfinite(exact) else float((k - 1.0) * np.log(half) - half - special.gammaln(k))


def spins(
    problem: PathProblem, blocks: Mapping[str, Mapping[str, Floats]], odd: Mapping[str, float], logs: Floats
) -> bool:
    """Whether wheels that spin are surer than anything without a name, wheels that slide as they brake among it."""
    of_speed = blocks.get("acceleration", {})
    if SPINNING not in of_speed:
        return False
    gains = _gains(problem, {name: {name: column} for name, column in of_speed.items()}, logs)
    spinning = gains.pop(SPINNING)
    p, others = log_chance(spinning, 1), [p for c, p in odd.items() if c != "acceleration"]
    surest = is_odd(p) and p < min(others, default=0.0)
    surest = surest and spinning > max(gains.values(), default=0.0) + AS_LIKELY
    return bool(surest and problem.with_columns({SPINNING: of_speed[SPINNING]}).told(SPINNING, logs)[0] > 0.0)


def beside_uneven(
    problem: PathProblem,
    blocks: dict[str, dict[str, Floats]],
    odd: Mapping[str, float],
    logs: Floats,
    usual: float,
    *,
    shown: bool,
) -> tuple[PathProblem, Mapping[str, float], Mapping[str, float]]:
    """With turns that are off by one share to the left and by another to the right, `oddities` with these, and beside them.

    Turns to one side do not tell it from a scale, and a path that it bends is odd over whatever it goes along with. Where the
    truth shows it the surest of all that has no name it is free, or where it has been `shown` so and is there still, and else within
    what is `usual` of it.
    """
    size = blocks.get("turn_rate", {}).get(ONE_SIZE)
    if size is None:
        return problem, odd, odd
    wider = problem.with_columns({ONE_SIZE: size})
    gain = problem.solve(logs).left - wider.solve(logs).left
    p = log_chance(gain, 1)
    others = {c: blocks[c] for c in odd if c != "turn_rate"} if is_odd(p) else {}
    chances = [log_chance(g, len(others[c])) for c, g in _gains(problem, others, logs).items()]
    surest = is_odd(p) and (shown or p < min(chances, default=0.0))
    if not surest and is_odd(odd["turn_rate"]):
        return problem, odd, odd
    del blocks["turn_rate"][ONE_SIZE]
    if surest:
        left = oddities(wider, blocks, logs)
        return wider, {**left, "turn_rate": min(p, odd["turn_rate"])}, left
    return replace(wider, known={**problem.known, ONE_SIZE: (0.0, usual)}), odd, odd


def one_sided(
    problem: PathProblem,
    one_size: Floats,
    logs: Floats,
    taken_out: Mapping[str, float],
    law: str = "",
    std: float = 1.0,
) -> float:
    """Twice the log of how much likelier a scale of the turns one way is than one of all turns, and a law beside it.

    That has one figure more, which is a chance the more, the more closely it is known of all that was possible.

    Parameters
    ----------
    one_size : ndarray, shape (rows,)
        What turns do that have one sign whichever way they go.
    taken_out : mapping
        Coefficients that the path is without.
    law, std : optional
        What a scale of the turns one way does without, and what is thought possible of it.
    """
    both = problem.columns[GYRO_SCALE.id]
    residual = problem.residual + taken_out[GYRO_SCALE.id] * both
    others = {n: column for n, column in problem.columns.items() if n != law}
    if law:
        residual = residual + taken_out[law] * problem.columns[law]
    known = {**problem.known, GYRO_SCALE.id: (0.0, problem.known[GYRO_SCALE.id][1])}
    ways = [
        replace(
            problem,
            residual=residual,
            columns={**others, GYRO_SCALE.id: 0.5 * (both + sign * one_size)},
            known=known,
        )
        for sign in (-1.0, 1.0)
    ]
    return _against(problem, logs) + 2.0 * float(np.log(std)) - min(_against(way, logs) for way in ways)


def _against(problem: PathProblem, logs: Floats) -> float:
    """Minus twice the log of the evidence of some columns, but for what all of the same noise share."""
    solved = problem.solve(logs)
    return solved.left - float(np.linalg.slogdet(solved.covariance)[1])
