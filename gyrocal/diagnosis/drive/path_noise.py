"""What the noise of gyro, wheels and truth makes of the positions and headings of a reckoned path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from gyrocal.diagnosis.drive.laws import BiasLaws
from gyrocal.diagnosis.drive.path_gaps import after_gaps, unknown
from gyrocal.diagnosis.drive.reckoning import Complexes, Floats, Reckoned
from gyrocal.diagnosis.drive.yaw import YawNoise
from gyrocal.physics.drive import FLICKER_TAUS_S
from gyrocal.units import DEG_TO_RAD

Ints = NDArray[np.int64]

#: Cells of time in each of which the gyro's noise makes one turn: two to a knot of the truth.
_CELLS = 300
#: What the encoders add to the error of the laws of the bias at the least, of the gyro's part of its variance.
_LEAST_REST = 1e-2
#: Memories of what wanders in the truth of which the likeliest is taken, s: multipath of satellites lasts minutes, a map's
#: errors as long as the robot takes through a room.
WANDERS_S = (20.0, 60.0, 180.0)


@dataclass(frozen=True)
class Knots:
    """Truth, which is known in `rows` of a log, averaged over equal times, shape (k,); `at` is the knot of each of these rows.

    Positions, headings or both; what it lacks is None.
    `laws` are those of the bias, each as what one unit of it adds to the rate in each row; the encoders know the first `told`.
    The gyro's noise makes one turn in each cell between `edges_s`, shape (c + 1,), which span the log.
    """

    rows: Ints
    at: Ints
    count: Floats
    t_s: Floats
    position: Complexes | None
    heading: Floats | None
    laws: Mapping[str, Floats]
    told: int
    edges_s: Floats

    def first(self, count: int) -> Knots:
        """The first of them."""
        rows = int(np.searchsorted(self.at, count))
        return replace(
            self,
            rows=self.rows[:rows],
            at=self.at[:rows],
            count=self.count[:count],
            t_s=self.t_s[:count],
            position=None if self.position is None else self.position[:count],
            heading=None if self.heading is None else self.heading[:count],
        )

    def mean(self, rows: NDArray) -> NDArray:  # type: ignore[type-arg]
        """Mean of a row-wise channel over each knot."""
        if np.iscomplexobj(rows):
            return np.asarray(self.mean(rows.real) + 1j * self.mean(rows.imag))
        return np.asarray(np.bincount(self.at, rows[self.rows]) / self.count)


def stacked(knots: Knots, positions: Complexes, headings: Floats, told: Floats | None = None) -> Floats:
    """Positions and headings, as far as the truth has them, one below the other; last the laws that the encoders tell."""
    of_path = _blocks(knots, positions, headings)
    return np.concatenate([of_path, np.zeros((knots.told, *of_path.shape[1:])) if told is None else told])


@dataclass(frozen=True)
class PathNoise:
    """Parts of the covariance of positions, headings and the laws that the encoders tell, stacked.

    `turned` is what a turn within each cell between `edges_s`, and then one in each gap, does to them, `kernel` the covariance
    of the former, and `unseen` that of positions and headings with the latter: the gyro has not seen them, and no law knows
    them.
    """

    turned: Floats
    kernel: Floats
    unseen: Floats

    gyro: Floats
    way: Floats
    white: Floats
    wander: Floats
    heading: Floats | None
    heading_wander: Floats | None

    def whole(self, logs: Floats) -> Floats:
        """Covariance at logarithms of the levels (way, white, wander, and of the headings white and wander)."""
        return np.asarray(sum(self.parts(logs), self.gyro))

    def parts(self, logs: Floats) -> list[Floats]:
        """Of these the parts that a level belongs to, in its order."""
        of_levels = [self.way, self.white, self.wander]
        of_levels += [m for m in (self.heading, self.heading_wander) if m is not None]
        return [np.exp(x) * part for x, part in zip(logs, of_levels, strict=True)]

    def strayed(self, left: Floats, logs: Floats) -> Floats:
        """Turns of the cells and in the gaps that noise is likeliest to have made, from what is left of positions and headings."""
        in_cells = self.turned[:, : self.kernel.shape[0]]
        spread = np.vstack([self.kernel @ in_cells.T, self.unseen.T])
        return np.asarray(spread @ np.linalg.solve(self.whole(logs), left))

    def remembering(self, knots: Knots, wander_s: float) -> PathNoise:
        """The same where what wanders in the truth has another memory."""
        positions, headings = _wander(knots, wander_s)
        return replace(self, wander=positions, heading_wander=headings)


def cell_edges_s(t_s: Floats, knots: int) -> Floats:
    """Edges of the cells for so many knots of a log."""
    return np.linspace(t_s[0], t_s[-1], min(_CELLS, 2 * knots) + 1)


def path_noise(knots: Knots, path: Reckoned, noise: YawNoise, known: BiasLaws, wander_s: float) -> PathNoise:
    """Covariance of positions, headings and known laws by its parts, for a path and the levels of its noise.

    `wander_s` is the memory of what wanders in the truth.
    """
    begin, edges = path.t_s[0], knots.edges_s
    width = float(edges[1] - edges[0])
    middle = 0.5 * (edges[1:] + edges[:-1])
    at_row = path.at_m
    at_cell = np.interp(middle, path.t_s, at_row.real) + 1j * np.interp(middle, path.t_s, at_row.imag)
    at_knot = knots.mean(at_row)
    after = np.clip((knots.t_s[:, None] - edges[None, :-1]) / width, 0.0, 1.0)
    # The part of a turn within a cell acts from that turn on.
    turned = after * 1j * (at_knot[:, None] - at_cell[None, :])
    weights = known.weights_between(edges)
    of_path = _blocks(knots, turned, after)
    turn = np.vstack([of_path, weights])
    lag = np.abs(middle[:, None] - middle[None, :])
    since = middle - begin
    rate = sum(np.exp(-lag / tau) for tau in FLICKER_TAUS_S) * (DEG_TO_RAD * noise.flicker_dps) ** 2
    rate = rate + (DEG_TO_RAD * noise.walk_dps_per_rt_s) ** 2 * np.minimum(since[:, None], since[None, :])
    kernel = rate * width**2 + np.eye(middle.size) * (DEG_TO_RAD * noise.arw_dps_per_rt_hz) ** 2 * width
    rolled = np.diff(np.interp(edges, path.t_s, np.cumsum(path.rolled_m)))
    ahead = np.exp(1j * np.interp(middle, path.t_s, path.heading_rad))
    along = _blocks(knots, after * ahead[None, :] * np.sqrt(0.5 * rolled)[None, :], 0.0 * after)
    turned_std, way_std = unknown(path, noise)
    share, of_turn = after_gaps(path, knots.rows, knots.count)
    by_turn = stacked(knots, of_turn, share)
    unseen = by_turn * turned_std**2
    gyro = turn @ kernel @ turn.T + unseen @ by_turn.T + _of_positions(knots, share * way_std**2 @ share.T)
    # The path follows the same gyro: taken for independent, both would swear to one noise. What else the laws found are off
    # by is the encoders', of which the path has nothing.
    told = knots.told
    gyro[-told:, -told:] = _at_least(known.covariance, (1.0 + _LEAST_REST) * gyro[-told:, -told:])
    one = 1.0 / knots.count
    wander, heading_wander = _wander(knots, wander_s)
    return PathNoise(
        np.hstack([turn, by_turn]),
        kernel,
        unseen,
        gyro + 1e-12 * np.eye(gyro.shape[0]),
        noise.slip_m_per_rt_m**2 * linalg.block_diag(along @ along.T, np.zeros((told, told))),
        _of_positions(knots, np.diag(one)),
        wander,
        _of_headings(knots, np.diag(one)) if knots.heading is not None else None,
        heading_wander,
    )


def _wander(knots: Knots, wander_s: float) -> tuple[Floats, Floats | None]:
    """Covariance of what wanders in the truth's positions, and in its headings where there are any."""
    fade = np.exp(-np.abs(knots.t_s[:, None] - knots.t_s[None, :]) / wander_s)
    return _of_positions(knots, fade), _of_headings(knots, fade) if knots.heading is not None else None


def _of_positions(knots: Knots, each: Floats) -> Floats:
    return _square(knots, each, 0.0 * each)


def _of_headings(knots: Knots, each: Floats) -> Floats:
    return _square(knots, 0.0 * each, each)


def _square(knots: Knots, of_position: Floats, of_heading: Floats) -> Floats:
    """A covariance of each coordinate of the positions and one of the headings, and none of the known laws."""
    parts = [of_position] * 2 if knots.position is not None else []
    headings = [of_heading] if knots.heading is not None else []
    return np.asarray(linalg.block_diag(*parts, *headings, np.zeros((knots.told, knots.told))))


def _at_least(covariance: Floats, least: Floats) -> Floats:
    """A covariance, in no direction smaller than another one."""
    size = np.sqrt(np.diag(covariance))
    root = np.linalg.cholesky(covariance / np.outer(size, size) + 1e-12 * np.eye(size.size)) * size[:, None]
    white = np.linalg.solve(root, np.linalg.solve(root, least).T)
    share, axes = np.linalg.eigh(0.5 * (white + white.T))
    wide = root @ axes * np.sqrt(np.maximum(share, 1.0))
    return np.asarray(wide @ wide.T)


def _blocks(knots: Knots, positions: Complexes, headings: Floats) -> Floats:
    parts = [positions.real, positions.imag] if knots.position is not None else []
    return np.concatenate([*parts, *([headings] if knots.heading is not None else [])])
