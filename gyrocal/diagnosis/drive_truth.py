"""A drive against the truth's positions and headings: what a dead-reckoned path can tell of distances and of the gyro.

The miss of a dead-reckoned path is no noise of single positions but a walk of the whole drive: an error of the heading
moves all that follows. The path is linearised about the smoothed one, and its noise is what dead reckoning has: walks of
heading, of gyro bias and of distance, and the truth's own noise, white and wandering; their levels come from the data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gyrocal.diagnosis.drive_path import KNOTS, Complexes, Path, independent, short_variance
from gyrocal.diagnosis.drive_reml import Fit, Source, fit
from gyrocal.diagnosis.drive_series import DriveSeries
from gyrocal.diagnosis.result import Located
from gyrocal.units import DEG_TO_RAD

Floats = NDArray[np.float64]

#: Fewest knots that are looked at.
_FEWEST = 12
_LEAST_ROWS, _LEAST_S = 30, 60.0
#: Memories of what wanders in the truth's positions, s.
_WANDER_S = (10.0, 60.0, 300.0)
#: Rounds of linearising about the smoothed path.
_ROUNDS = 3
#: What is known beforehand of a walk's level: within a factor of e, standard deviation of the logarithm of a variance.
_SPREAD = 2.0
#: Bias that builds up over a drive, where nothing else is known, deg/s.
_BIAS_DRIFT_DPS = 0.01

#: A truth that moves by less than this share of the path stands still; one whose wandering is a larger share of its
#: own extent than this does not follow the path (a mirrored frame, another robot's log).
_STILL, _ASTRAY = 0.05, 0.25
#: Scales this far off are believed only if the path then meets the truth.
_ODD = 0.2
#: What a row's time stamp and the steps between rows are worth: no scale is known better.
_MODEL_STD = {"wheel_scale": 1e-4, "gyro_scale": 1e-4}
#: Sizes of errors that are met with, to begin with, and parts of the drive over which the path is laid first.
_USUAL = {"wheel_scale": 0.1, "gyro_scale": 0.1, "gyro_bias": 0.3}
_HORIZONS = (0.04, 0.08, 0.16, 0.32, 0.64)

INTERESTS = ("wheel_scale", "gyro_scale", "gyro_bias")


@dataclass(frozen=True)
class Walks:
    """What is known beforehand of dead reckoning's noise.

    Variance of the heading per s, rad^2, and of the distance per m, m^2; standard deviation of the gyro's bias, deg/s;
    isolated slips of a wheel: begin and end since the log began, s, and what the robot's centre then seems to move, m.
    """

    heading: float
    distance: float
    bias_dps: float
    slips: tuple[tuple[float, float, float], ...] = ()


@dataclass(frozen=True)
class TruthFit:
    """What the truth says.

    Attributes
    ----------
    values, stds, freedoms, p_values : mapping
        Of each of `INTERESTS` that this drive can tell: distances too long by (relative), gyro scale too large by
        (relative), gyro bias (deg/s).
    correlation : float
        Of distance scale and gyro scale.
    nominal_m, miss_m : float
        By how much the reckoned path misses the positions, m rms: as logged, and with these parameters taken out.
    levels : mapping
        Variance of each source of noise.
    places : tuple
        Structure that no parameter takes up and no noise of dead reckoning makes.
    headings : bool
        Whether the truth has headings.
    follows : bool
        Whether the truth follows the path at all; if not, nothing here means anything.
    """

    values: Mapping[str, float]
    stds: Mapping[str, float]
    freedoms: Mapping[str, float]
    p_values: Mapping[str, float]
    correlation: float
    nominal_m: float
    miss_m: float
    levels: Mapping[str, float]
    places: tuple[Located, ...]
    headings: bool
    follows: bool = True


def truth_fit(series: DriveSeries, delay_s: float, walks: Walks, level: float) -> TruthFit | None:
    """Fit the truth; None where there is none, or too little of it.

    Parameters
    ----------
    delay_s : float
        The gyro is looked at so much earlier, as in `bins_of`.
    level : float
        Rate of false places.
    """
    known = np.isfinite(series.truth_x_m) & np.isfinite(series.truth_y_m)
    t = series.t_s[known]
    if known.sum() < _LEAST_ROWS or t[-1] - t[0] < _LEAST_S:
        return None
    path = Path(series, delay_s)
    if path.count.size < _FEWEST:
        return None
    smoother = _Smoother(path, walks, series)
    if smoother.stands_still():
        return TruthFit({}, {}, {}, {}, 0.0, np.nan, np.nan, {}, (), path.has_heading, follows=False)
    return smoother.answer(level)


class _Smoother:
    """Gauss and Newton with the walks smoothed: linearise, estimate levels and parameters, lay the path anew."""

    def __init__(self, path: Path, walks: Walks, series: DriveSeries) -> None:
        self.path, self.walks = path, walks
        self.backward = bool(np.any(path.ds < 0))
        # Walks are looked at in so many equal steps of rows' time.
        edges = np.linspace(0.0, path.t_s[-1], min(2 * path.count.size, 2 * KNOTS) + 1)
        self.cell = np.clip(np.searchsorted(edges, path.t_s, side="left") - 1, 0, edges.size - 2)
        self.cells = edges.size - 1
        self.width_s = float(edges[1] - edges[0])
        self.heading_error = np.zeros(path.t_s.size)
        self.distance_error = np.zeros(path.t_s.size)
        self.values: dict[str, float] = dict.fromkeys(INTERESTS, 0.0)
        self.turn = self._first_turn()

    def _first_turn(self) -> complex:
        """Direction in which the path lies best, as a factor."""
        reckoned = self.path.mean(self.path.reckon(self.path.heading, self.path.ds)[1])
        a, b = reckoned - reckoned.mean(), self.path.truth - self.path.truth.mean()
        found = complex(np.vdot(a, b))
        return found / abs(found) if abs(found) > 0 else 1.0 + 0.0j

    def stands_still(self) -> bool:
        """Whether the truth stays where it is while the wheels move."""
        reckoned = self.path.mean(self.path.reckon(self.path.heading, self.path.ds)[1])
        return bool(np.std(self.path.truth) < _STILL * np.std(reckoned))

    def _stack(self, positions: Complexes, headings: Floats, known_dps: float = 0.0) -> Floats:
        """Rows: positions, headings where there are any, and what is known of the gyro's bias beforehand."""
        parts = [positions.real, positions.imag, *([headings] if self.path.has_heading else [])]
        return np.concatenate([*parts, [known_dps]])

    def _column(
        self, steps: Complexes, heading: Floats, heading_rate: Floats, distance_rate: Floats
    ) -> Floats:
        """What errors of heading (rad a row) and distance (m a row) do to the positions and headings."""
        error = np.cumsum(heading_rate)
        positions = self.path.mean(np.cumsum(1j * error * steps + distance_rate * np.exp(1j * heading)))
        return self._stack(positions, self.path.mean(error))

    def _walks(self, steps: Complexes, heading: Floats, at: Complexes) -> tuple[Floats, Floats, Floats]:
        """Responses, (rows, cells), to a unit of white heading rate, of a walk of the bias, of white distance."""
        p = self.path
        middle = np.zeros(self.cells, dtype=np.complex128)
        count = np.maximum(np.bincount(self.cell, minlength=self.cells), 1)
        whole = np.cumsum(steps)
        middle += np.bincount(self.cell, whole.real, self.cells) / count
        middle += 1j * np.bincount(self.cell, whole.imag, self.cells) / count
        empty = np.bincount(self.cell, minlength=self.cells) == 0
        if empty.any():
            filled = np.flatnonzero(~empty)
            middle = np.interp(np.arange(self.cells), filled, middle[filled].real) + 1j * np.interp(
                np.arange(self.cells), filled, middle[filled].imag
            )
        begin = (np.arange(self.cells) + 0.5) * self.width_s
        after = np.clip((p.at_s[:, None] - begin[None, :]) / self.width_s + 0.5, 0.0, 1.0)
        turned = after * 1j * (at[:, None] - middle[None, :])
        none = np.zeros((1, self.cells))
        white = np.vstack([turned.real, turned.imag, *([after] if p.has_heading else []), none])
        white = white * np.sqrt(self.width_s)
        # A step of the bias goes on to the end: all later heading errors.
        drift = np.cumsum(white[:, ::-1], axis=1)[:, ::-1] * self.width_s
        way = np.bincount(self.cell, p.way, self.cells)
        ahead = np.bincount(self.cell, steps.real, self.cells) + 1j * np.bincount(
            self.cell, steps.imag, self.cells
        )
        size = np.abs(ahead)
        ahead = np.divide(ahead, size, out=np.zeros_like(ahead), where=size > 0) * np.sqrt(way)
        along = after * ahead[None, :]
        distance = np.vstack([along.real, along.imag, *([0.0 * after] if p.has_heading else []), none])
        return white, drift, distance

    def _slips(self, steps: Complexes, heading: Floats) -> Floats:
        """Responses, (rows, slips), to the distance that each isolated slip pretends."""
        p = self.path
        nothing = np.zeros(p.t_s.size)
        parts = []
        for begin, end, size_m in self.walks.slips:
            during = (p.t_s > begin) & (p.t_s <= end)
            share = during * size_m / max(int(np.count_nonzero(during)), 1)
            parts.append(self._column(steps, heading, nothing, share))
        return np.stack(parts, axis=1)

    def _sources(self, responses: Sequence[Floats], slips: Floats | None, residual: Floats) -> list[Source]:
        p = self.path
        n = p.count.size
        white, drift, distance = (r @ r.T for r in responses)
        beforehand = np.zeros_like(white)
        beforehand[-1, -1] = 1.0
        length_s = p.t_s[-1]
        gap = np.abs(np.subtract.outer(p.at_s, p.at_s))
        positions = slice(0, 2 * n)
        rows = white.shape[0]

        def placed(block: Floats, at: Sequence[int]) -> Floats:
            out = np.zeros((rows, rows))
            for k in at:
                out[k * n : (k + 1) * n, k * n : (k + 1) * n] = block
            return out

        guess = max(short_variance(residual[:n], p.count), short_variance(residual[n : 2 * n], p.count), 1e-8)
        found = [
            Source("heading", white, self.walks.heading, _SPREAD),
            Source("bias", drift, (DEG_TO_RAD * _BIAS_DRIFT_DPS) ** 2 / length_s, _SPREAD),
            Source("distance", distance, self.walks.distance, _SPREAD),
            Source("bias beforehand", beforehand, self.walks.bias_dps**2, _SPREAD),
            Source("white", placed(np.diag(1.0 / p.count), (0, 1)), guess),
        ]
        wander = float(np.var(residual[positions])) + 1e-8
        if slips is not None:
            found.append(Source("slips", slips @ slips.T, 1.0, _SPREAD))
        found += [
            Source(f"wander {tau:g} s", placed(np.exp(-gap / tau), (0, 1)), 0.1 * wander) for tau in _WANDER_S
        ]
        if p.has_heading:
            guess = max(short_variance(residual[2 * n : 3 * n], p.count), 1e-12)
            found.append(Source("headings white", placed(np.diag(1.0 / p.count), (2,)), guess))
            wander = float(np.var(residual[2 * n : 3 * n])) + 1e-12
            found.append(Source("headings wander", placed(np.exp(-gap / _WANDER_S[0]), (2,)), 0.1 * wander))
        return found

    def _design(
        self, steps: Complexes, ds: Floats, heading: Floats
    ) -> tuple[dict[str, Floats], dict[str, Floats]]:
        """Columns of the nuisances, and of the interests."""
        p = self.path
        nothing, n = np.zeros(p.t_s.size), p.count.size
        flat = np.zeros(n)
        at, ahead = np.cumsum(steps), np.exp(1j * heading)
        speed = np.divide(steps, p.dt, out=np.zeros_like(steps), where=p.dt > 0)
        one = np.ones(n, dtype=np.complex128)
        middle = p.mean(at)
        nuisances = {
            "east": self._stack(one, flat),
            "north": self._stack(1j * one, flat),
            "direction": self._stack(1j * (middle - middle.mean()), flat),
            "clock": self._stack(p.mean(speed), flat),
            "delay": self._column(steps, heading, np.diff(p.rate, prepend=0.0), nothing),
            "lever ahead": self._stack(p.mean(ahead), flat),
            "lever left": self._stack(p.mean(1j * ahead), flat),
        }
        if self.walks.slips:
            nuisances["slips"] = np.sum(self._slips(steps, heading), axis=1)
        if p.has_heading:
            nuisances["mounting"] = self._stack(np.zeros(n, dtype=np.complex128), np.ones(n))
        turned = np.diff(p.heading, prepend=p.heading[0])
        interests = {
            "wheel_scale": self._column(steps, heading, nothing, -ds),
            "gyro_scale": self._column(steps, heading, -turned, nothing),
            "gyro_bias": self._column(steps, heading, -DEG_TO_RAD * p.dt, nothing),
        }
        interests["gyro_bias"][-1] = 1.0
        return nuisances, interests

    def _strangers(self, steps: Complexes, ds: Floats, heading: Floats) -> dict[str, Floats]:
        """Columns of what no parameter here explains; coordinate -> (rows, k)."""
        p = self.path
        nothing = np.zeros(p.t_s.size)
        fast = np.abs(p.rate)
        speed = np.abs(np.divide(ds, p.dt, out=np.zeros_like(ds), where=p.dt > 0))
        pace = np.convolve(speed, np.ones(9) / 9, "same")
        turned = p.rate * p.dt
        gained = np.diff(pace, prepend=pace[:1])
        columns = {
            "turn_rate": [
                self._column(steps, heading, fast * p.dt, nothing),
                self._column(steps, heading, fast * turned, nothing),
                self._column(steps, heading, nothing, ds * fast),
            ],
            "speed": [
                self._column(steps, heading, nothing, ds * pace),
                self._column(steps, heading, ds, nothing),
            ],
            # Gained in starts and lost in stops would be a clock that is off, which is free already.
            "acceleration": [self._column(steps, heading, nothing, np.abs(gained))],
            "time": [self._column(steps, heading, nothing, ds * p.t_s / p.t_s[-1])],
        }
        return {name: np.stack(parts, axis=1) for name, parts in columns.items()}

    def _linear(self) -> tuple[Complexes, Floats, Floats]:
        """Steps, distances and headings of the path with all that is known of its errors taken out."""
        p, v = self.path, self.values
        heading = p.heading * (1 - v["gyro_scale"]) - DEG_TO_RAD * v["gyro_bias"] * p.t_s + self.heading_error
        ds = p.ds * (1 - v["wheel_scale"]) + self.distance_error
        steps, _ = p.reckon(heading, ds)
        return self.turn * steps, ds, heading + np.angle(self.turn)

    def _lay(self) -> None:
        """Turn, scales and bias by plain least squares over a growing part of the drive.

        Over a whole drive a heading may be wrong by turns, and Gauss and Newton would not find back.
        """
        kept = dict(self.values), self.turn
        before = self._rough(1.0)[0]
        for share in (*_HORIZONS, 1.0):
            for _ in range(2):
                _, change, turn = self._rough(share)
                for name, step in change.items():
                    self.values[name] += step
                self.turn *= np.exp(1j * turn)
        if not self._rough(1.0)[0] < before:
            self.values, self.turn = kept

    def _rough(self, share: float) -> tuple[float, dict[str, float], float]:
        """Miss over the first part of the drive, and the changes of the interests and of the direction that lessen it."""
        p = self.path
        steps, ds, heading = self._linear()
        nuisances, interests = self._design(steps, ds, heading)
        columns = {n: nuisances[n] for n in ("east", "north", "direction")} | interests
        if p.has_heading:
            columns["mounting"] = nuisances["mounting"]
        rows = np.append(np.tile(p.at_s <= share * p.t_s[-1], 3 if p.has_heading else 2), False)
        miss = self._stack(p.truth - p.mean(np.cumsum(steps)), self._heading_miss(heading))[rows]
        matrix = np.stack(list(columns.values()), axis=1)[rows]
        if p.has_heading:
            # A heading counts as much as the position it leads to over a way of a tenth of the drive.
            weight = 0.1 * float(np.sum(p.way))
            matrix[-miss.size // 3 :] *= weight
            miss[-miss.size // 3 :] *= weight
        centre = slice(0, miss.size)
        # Held to what gyros and wheels are, as if by so many positions missed by their usual miss.
        held = np.array([0.0 if n not in INTERESTS else 1.0 / _USUAL[n] for n in columns])
        spread = float(np.sqrt(np.mean(miss**2))) + 1e-6
        matrix = np.vstack([matrix[centre], spread * np.diag(held)])
        now = np.array([self.values.get(n, 0.0) for n in columns])
        target = np.concatenate([miss, -spread * held * now])
        size = np.linalg.norm(matrix, axis=0) + 1e-300
        found = np.linalg.lstsq(matrix / size, target, rcond=1e-10)[0] / size
        left = miss - matrix[centre] @ np.where(
            [n in ("east", "north", "mounting") for n in columns], found, 0.0
        )
        told = dict(zip(columns, found, strict=True))
        return float(left @ left), {n: float(told[n]) for n in INTERESTS}, float(told["direction"])

    def answer(self, level: float) -> TruthFit:
        """Parameters, their p-values, and what is left."""
        nominal_m = self._miss()
        self._lay()
        levels, sources = None, []
        for _ in range(_ROUNDS):
            steps, ds, heading = self._linear()
            at = self.path.mean(np.cumsum(steps))
            nuisances, interests = self._design(steps, ds, heading)
            columns, names = independent(nuisances, interests)
            responses = self._walks(steps, heading, at)
            # What is taken out already, smoothed errors and parameters, comes back into what is to be explained.
            known = -self.values["gyro_bias"]
            y = self._stack(self.path.truth - at, self._heading_miss(heading), known)
            y += self._column(steps, heading, np.diff(self.heading_error, prepend=0.0), self.distance_error)
            y += sum((self.values[n] * interests[n] for n in INTERESTS), np.zeros(y.size))
            size = np.linalg.norm(columns, axis=0)
            if levels is None:
                plain = y - columns / size @ np.linalg.lstsq(columns / size, y, rcond=None)[0]
            slips = self._slips(steps, heading) if self.walks.slips else None
            sources = self._sources(responses, slips, plain)
            found = fit(y, columns / size, sources, levels)
            levels = found.levels
            values = dict(zip(names, found.values / size, strict=True))
            self._smooth(found, responses, values)
        stds = dict(zip(names, np.sqrt(np.diag(found.covariance)) / size, strict=True))
        strangers = self._strangers(steps, ds, heading)
        return self._told(found, values, stds, sources, strangers, nominal_m, level)

    def _miss(self) -> float:
        """Miss of the path as reckoned, laid upon the positions, m rms."""
        p = self.path
        at = p.mean(np.cumsum(self._linear()[0]))
        a, b = at - at.mean(), p.truth - p.truth.mean()
        turn = complex(np.vdot(a, b))
        left = b - a * (turn / abs(turn) if abs(turn) > 0 else 1.0)
        return float(np.sqrt(np.mean(np.abs(left) ** 2)))

    def _heading_miss(self, heading: Floats) -> Floats:
        if not self.path.has_heading:
            return np.zeros(self.path.count.size)
        off = np.unwrap(self.path.truth_heading[self.path.known] - heading[self.path.known])
        off = off - 2 * np.pi * np.round(np.median(off) / (2 * np.pi))
        return np.asarray(np.bincount(self.path.knot, off) / self.path.count)

    def _smooth(self, found: Fit, responses: Sequence[Floats], values: Mapping[str, float]) -> None:
        """The most likely walks, to linearise about."""
        p = self.path
        heading, drift, along = (
            level * (r.T @ found.weighted) for level, r in zip(found.levels[:3], responses, strict=True)
        )
        rate = np.cumsum(drift) * np.sqrt(self.width_s) + heading / np.sqrt(self.width_s)
        edges = np.arange(self.cells + 1) * self.width_s
        self.heading_error = np.interp(p.t_s, edges, np.concatenate([[0.0], np.cumsum(rate) * self.width_s]))
        way = np.bincount(self.cell, p.way, self.cells)
        per_m = np.divide(along, np.sqrt(way), out=np.zeros_like(way), where=way > 0)
        self.distance_error = per_m[self.cell] * p.way
        for name in INTERESTS:
            self.values[name] = float(values.get(name, 0.0))
        self.turn *= np.exp(1j * float(values["direction"]))

    def _told(
        self, found: Fit, values: Mapping[str, float], stds: Mapping[str, float], sources: Sequence[Source],
        strangers: Mapping[str, Floats], nominal_m: float, level: float,
    ) -> TruthFit:  # fmt: skip
        names = list(values)
        told = [n for n in INTERESTS if n in values]
        spread = {n: float(np.hypot(stds[n], _MODEL_STD.get(n, 0.0))) for n in told}
        freedoms = {n: found.freedom(np.eye(len(names))[names.index(n)]) for n in told}
        p_values = {n: float(2 * stats.t.sf(abs(values[n]) / spread[n], freedoms[n])) for n in told}
        places = []
        for coordinate, columns in strangers.items():
            p_value, _ = found.excess(columns)
            if p_value < level / len(strangers):
                where = "the truth's path beside the reckoned one"
                places.append(Located(coordinate, "mean", where, p_value, float("nan"), True))
        correlation = 0.0
        if {"wheel_scale", "gyro_scale"} <= set(told):
            i, j = names.index("wheel_scale"), names.index("gyro_scale")
            shared = found.covariance[i, j] / np.sqrt(found.covariance[i, i] * found.covariance[j, j])
            correlation = float(shared)
        levels = {s.name: float(v) for s, v in zip(sources, found.levels, strict=True)}
        self.heading_error[:], self.distance_error[:] = 0.0, 0.0
        miss_m, extent_m = self._miss(), float(np.std(self.path.truth))
        wander_m = np.sqrt(2 * sum(v for n, v in levels.items() if n.startswith("wander")))
        odd = max(abs(values.get(n, 0.0)) for n in _MODEL_STD) > _ODD
        follows = wander_m < _ASTRAY * extent_m and not (odd and miss_m > 0.1 * extent_m)
        return TruthFit(
            {n: float(values[n]) for n in told}, spread, freedoms, p_values, correlation, nominal_m, miss_m,
            levels, tuple(places), self.path.has_heading, bool(follows),
        )  # fmt: skip
