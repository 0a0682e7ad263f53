"""`diagnose` on a drive log: what does the encoders' heading say that the gyro's does not, and which physics is it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from gyrocal.diagnosis import robust
from gyrocal.diagnosis.drive_effects import (
    EFFECTS,
    Candidate,
    Coordinate,
    candidates,
    coordinates,
    delay_slope,
    law,
    region,
    strongest_first,
)
from gyrocal.diagnosis.drive_noise import YawNoise, slips_place
from gyrocal.diagnosis.drive_rests import Rest, evidence_of_rests, rests, rests_speak_against
from gyrocal.diagnosis.drive_series import MAX_DELAY_S, Bins, DriveSeries, bins_of
from gyrocal.diagnosis.gram import benjamini_hochberg, holm
from gyrocal.diagnosis.result import Estimate, Located
from gyrocal.records.robot import BIAS_STD_AFTER_REST_DPS

Floats = NDArray[np.float64]

#: Family-wise rate of false names, and rate of false places. The five laws of the heading difference share it with
#: the three checks that stand for themselves (wheel out of true, scale of distance, scale of the gyro).
LEVEL = 0.01
LEVEL_OF_LAWS, LEVEL_OF_A_CHECK = LEVEL * 5 / 8, LEVEL / 8
#: Rows of a block that counts as independent of its neighbours, s.
BLOCK_S = 10.0
DRAWS = 3999
_MAX_EFFECTS = 6
#: A law is not named where one that failed its test, or that the rests refute, fits better by this, nats (20 to 1).
_CLEAR_NATS = 3.0
#: A bias within so many standard deviations of what the robot file grants is none.
_KNOWN_STDS = 2.0
_OF_THE_BIAS = frozenset({"gyro_bias", "bias_temperature"})


@dataclass(frozen=True)
class Model:
    """What has been named so far: a delay, and columns beside it."""

    delay_s: float = 0.0
    delayed: bool = False
    members: tuple[Candidate, ...] = ()

    def names(self) -> tuple[str, ...]:
        """Ids of the named effects."""
        return (*(("gyro_delay",) if self.delayed else ()), *(m.effect for m in self.members))


@dataclass(frozen=True)
class YawFit:
    """Heading difference explained.

    Attributes
    ----------
    before_deg, after_deg : ndarray, shape (bins,)
        Encoders less gyro in each bin: nominal model, and with the named effects.
    law_deg : mapping
        What each named effect adds, deg a bin.
    places : tuple
        Where the excess lives; ``remains`` where it is still there.
    p_values, rivals : mapping
        Of each named effect: its p-value; effect -> evidence of the name against it.
    """

    bins: Bins
    model: Model
    parameters: dict[str, dict[str, Estimate]]
    p_values: dict[str, float]
    rivals: dict[str, dict[str, float]]
    before_deg: Floats
    after_deg: Floats
    law_deg: dict[str, Floats]
    places: tuple[Located, ...]
    phi: Floats = field(repr=False)
    noise: YawNoise = field(repr=False)


def _rows_per_block(bins: Bins) -> int:
    return max(1, round(BLOCK_S / bins.width_s))


def _columns(series: DriveSeries, model: Model, bins: Bins) -> Floats:
    """Columns of a model: its members, and the slope of its delay, which stays free once it is named."""
    parts = [m.columns for m in model.members]
    if model.delayed:
        parts.append(delay_slope(series, model.delay_s)[:, None])
    return np.hstack(parts) if parts else np.zeros((bins.t_s.size, 0))


@dataclass(frozen=True)
class Question:
    """What is to be explained: a log, its noise, what the gyro says at rest, and laws that must not be named."""

    series: DriveSeries
    noise: YawNoise
    rests: tuple[Rest, ...]
    banned: frozenset[str] = frozenset()

    @property
    def bias_std_dps(self) -> float:
        """What is known of the gyro's bias beforehand: that it is zero within this standard deviation."""
        return max(self.series.robot.initial_std.get("gyro_bias_dps", BIAS_STD_AFTER_REST_DPS), 1e-6)

    @staticmethod
    def of(series: DriveSeries, noise: YawNoise) -> Question:
        """The question that a log asks."""
        return Question(series, noise, rests(series))


def _regression(asked: Question, model: Model, *, bias_free: bool = False) -> tuple[Bins, robust.Regression]:
    # Bins count alike: what a model lacks makes scatter in turns, and to give turns less weight would hide it.
    bins = bins_of(asked.series, model.delay_s)
    y = bins.encoder_deg - bins.gyro_deg
    columns = np.hstack([_columns(asked.series, model, bins), asked.noise.dummies()])
    if bias_free and "gyro_bias" not in model.names():
        columns = np.column_stack([columns, np.ones(y.size)])
    plain = y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0] if columns.shape[1] else y
    return bins, robust.regress(y, columns, robust.autoregression(plain), _rows_per_block(bins))


def _signs(regression: robust.Regression, seed: int) -> Floats:
    rng = np.random.default_rng([seed, 4711])
    return rng.choice([-1.0, 1.0], size=(DRAWS, regression.blocks.size))


def search(asked: Question, seed: int) -> tuple[Model, dict[str, float], dict[str, dict[str, float]]]:
    """Forward selection under family-wise control; ``(model, p-values, rivals)``."""
    series = asked.series
    model, p_values, rivals = Model(), {}, {}
    vetoed: set[str] = set()
    while len(model.names()) < _MAX_EFFECTS:
        bins, regression = _regression(asked, model)
        signs = _signs(regression, seed)
        families = {
            effect: family
            for effect, family in candidates(series, bins, model.delay_s).items()
            if effect not in (*model.names(), *asked.banned)
        }
        if not families:
            break
        tests = {e: robust.score_test(regression, [c.columns for c in f], signs) for e, f in families.items()}
        passed = holm(np.array([t.p_value for t in tests.values()]), LEVEL_OF_LAWS)
        accepted = [
            e
            for e, ok in zip(tests, passed, strict=True)
            if ok and tests[e].gain_nats > 0 and e not in vetoed
        ]
        if not accepted:
            break
        gains = {e: t.gain_nats for e, t in tests.items()}
        wider = {e: _with(series, model, families[e][tests[e].best], asked.noise) for e in accepted}
        now = _bias_law(asked, model)
        for effect in _OF_THE_BIAS & set(accepted):
            gains[effect] += evidence_of_rests(asked.rests, now, _bias_law(asked, wider[effect]))
        best = max(accepted, key=lambda e: gains[e])
        if max(gains.values()) > gains[best] + _CLEAR_NATS:
            break
        then = _bias_law(asked, wider[best])
        small = (
            best == "gyro_bias"
            and series.robot.static_s > 0
            and abs(then[0]) < _KNOWN_STDS * asked.bias_std_dps
        )
        if small or rests_speak_against(asked.rests, now, then):
            vetoed.add(best)
            continue
        model = wider[best]
        p_values[best] = tests[best].p_value
        rivals[best] = {
            e: float(np.exp(min(gains[best] - gain, 50.0)))
            for e, gain in gains.items()
            if e != best and gains[best] - gain < _CLEAR_NATS
        }
    return _pruned(asked, model, p_values, rivals, seed)


def _bias_law(asked: Question, model: Model) -> tuple[float, float]:
    """What a model says of the gyro at rest: bias, deg/s, and its slope over temperature, deg/s per degC."""
    members = [m.effect for m in model.members]
    if not _OF_THE_BIAS & set(members):
        return 0.0, 0.0
    values = dict(zip(members, _fitted(asked, model)[0], strict=False))
    return float(values.get("gyro_bias", 0.0)), float(values.get("bias_temperature", 0.0))


def _fitted(asked: Question, model: Model) -> tuple[Floats, Floats, Floats, Bins, robust.Regression]:
    """Coefficients of a model's columns, their covariance, its degrees of freedom; bins and regression."""
    bins, regression = _regression(asked, model)
    columns = _columns(asked.series, model, bins)
    # A bias that is too small to be named still leans on the other laws.
    held = None
    if not _OF_THE_BIAS & set(model.names()):
        held = (np.ones(bins.t_s.size), bins.width_s * asked.bias_std_dps)
    values, covariance, dof = robust.fit(
        bins.encoder_deg - bins.gyro_deg,
        columns,
        regression.phi,
        _rows_per_block(bins),
        asked.noise.dummies(),
        held,
    )
    return values, covariance, dof, bins, regression


def _with(series: DriveSeries, model: Model, chosen: Candidate, noise: YawNoise) -> Model:
    if chosen.effect == "gyro_delay":
        model = replace(model, delay_s=chosen.shape["delay_s"], delayed=True)
    else:
        model = replace(model, members=(*model.members, chosen))
    return refitted(series, model, noise.used, MAX_DELAY_S)


def refitted(series: DriveSeries, model: Model, used: NDArray[np.bool_], reach_s: float = 0.1) -> Model:
    """A model whose delay, where it has one, is the best for the bins `used`, shape (bins,), within `reach_s`."""
    if not model.delayed:
        return model

    def left(delay_s: float) -> float:
        bins = bins_of(series, delay_s)
        members = _moved(series, model, delay_s).members
        columns = np.column_stack([bins.gyro_deg, *(m.columns for m in members)])[used]
        y = bins.encoder_deg[used]
        residual = y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
        return float(residual @ residual)

    low, high = max(model.delay_s - reach_s, -MAX_DELAY_S), min(model.delay_s + reach_s, MAX_DELAY_S)
    grid = np.linspace(low, high, max(5, round((high - low) / 0.025) + 1))
    start = float(grid[int(np.argmin([left(d) for d in grid]))])
    width = float(grid[1] - grid[0])
    bounds = (max(start - width, low), min(start + width, high))
    found = optimize.minimize_scalar(left, bounds=bounds, method="bounded", options={"xatol": 1e-5})
    return _moved(series, model, float(found.x))


def _moved(series: DriveSeries, model: Model, delay_s: float) -> Model:
    """The same model with another delay: the columns follow the gyro."""
    bins = bins_of(series, delay_s)
    members = tuple(law(series, bins, m.effect, m.shape) for m in model.members)
    return replace(model, delay_s=delay_s, members=members)


def _pruned(
    asked: Question,
    model: Model,
    p_values: dict[str, float],
    rivals: dict[str, dict[str, float]],
    seed: int,
) -> tuple[Model, dict[str, float], dict[str, dict[str, float]]]:
    """Without the effects that the later ones have made superfluous."""
    for member in model.members:
        rest = replace(model, members=tuple(m for m in model.members if m is not member))
        _, regression = _regression(asked, rest)
        test = robust.score_test(regression, [member.columns], _signs(regression, seed))
        p_values[member.effect] = max(p_values[member.effect], test.p_value)
        if test.p_value > LEVEL:
            model = rest
    names = model.names()
    return model, {n: p_values[n] for n in names}, {n: rivals[n] for n in names}


def explain(asked: Question, seed: int) -> YawFit:
    """Explain the difference between the encoders' heading and the gyro's."""
    series = asked.series
    model, p_values, rivals = search(asked, seed)
    values, covariance, dof, bins, regression = _fitted(asked, model)
    y = bins.encoder_deg - bins.gyro_deg
    t95 = np.atleast_1d(stats.t.ppf(0.975, dof))
    parameters, laws, taken = {}, {}, np.zeros(y.size)
    for i, member in enumerate(model.members):
        std = float(np.sqrt(covariance[i, i]))
        amplitude = _estimate(
            values[i], std, float(t95[i]), member.scale, EFFECTS[member.effect].parameters[0].unit
        )
        shape = {k: Estimate(v, float("nan"), "1", (float("nan"),) * 2) for k, v in member.shape.items()}
        parameters[member.effect] = {"amplitude": amplitude} | shape
        laws[member.effect] = member.columns[:, 0] * values[i]
        p_values[member.effect] = max(
            p_values[member.effect], float(2 * stats.t.sf(abs(values[i]) / std, dof[i]))
        )
        taken = taken + laws[member.effect]
    nominal = bins_of(series, 0.0)
    if model.delayed:
        # The encoders are late by the delay: the gyro, dated by them, is early.
        std = float(np.sqrt(covariance[-1, -1]))
        parameters["gyro_delay"] = {"amplitude": _estimate(-model.delay_s, std, float(t95[-1]), 1.0, "s")}
        laws["gyro_delay"] = bins.gyro_deg - nominal.gyro_deg
    before, after = nominal.encoder_deg - nominal.gyro_deg, y - taken
    places = _places(asked, model, after, seed)
    return YawFit(
        bins, model, parameters, p_values, rivals, before, after, laws, places, regression.phi, asked.noise
    )


def _estimate(value: float, std: float, t95: float, scale: float, unit: str) -> Estimate:
    value, std = scale * float(value), scale * std
    return Estimate(value, std, unit, (value - t95 * std, value + t95 * std))


def _places(asked: Question, model: Model, left: Floats, seed: int) -> tuple[Located, ...]:
    """Coordinates on which the nominal model leaves structure, and those on which the named one, that leaves `left`, does."""
    series = asked.series
    # The mean at rest leaves a little bias, which later rests would show as structure in speed or time.
    bins, nominal = _regression(asked, Model(), bias_free=True)
    before = coordinates(series, bins, 0.0)
    p_before, share = _test_each(nominal, before, seed)
    bins, named = _regression(asked, model, bias_free=True)
    after = coordinates(series, bins, model.delay_s)
    p_after, share_after = _test_each(named, after, seed)
    remains = holm(np.array(p_after), LEVEL)
    excess = benjamini_hochberg(np.array(p_before), LEVEL) | remains
    found = []
    for i, coordinate in enumerate(before):
        if excess[i]:
            regression, place = (named, after[i]) if remains[i] else (nominal, coordinate)
            where = region(place, _curve(regression, place))
            p_value, part = (p_after[i], share_after[i]) if remains[i] else (p_before[i], share[i])
            found.append(Located(coordinate.name, "mean", where, p_value, part, bool(remains[i])))
    slips = slips_place(bins, asked.noise)
    found += [] if slips is None else [slips]
    return strongest_first([*found, *_scatter(left, named.blocks.size, after, asked.noise, seed)])


def _test_each(
    regression: robust.Regression, places: Sequence[Coordinate], seed: int
) -> tuple[list[float], list[float]]:
    """p-value of each coordinate's curves, and their share of what the model leaves."""
    signs = _signs(regression, seed)
    p_values, shares = [], []
    for place in places:
        p_values.append(robust.score_test(regression, [place.columns], signs).p_value)
        curve = _curve(regression, place, whitened=True)
        shares.append(float(curve @ curve) / regression.rss)
    return p_values, shares


def _curve(regression: robust.Regression, place: Coordinate, *, whitened: bool = False) -> Floats:
    """A coordinate's curves fitted to what a model leaves; shape (rows,) whitened, else (bins,)."""
    free = regression.free(place.columns)
    values = np.linalg.lstsq(free, regression.residual, rcond=None)[0]
    return np.asarray(free @ values if whitened else place.columns @ values)


def _scatter(
    left: Floats, blocks: int, places: Sequence[Coordinate], noise: YawNoise, seed: int
) -> list[Located]:
    """Coordinates on which the size of what is left changes beyond the noise's growth with way and turn."""
    squares = (left / noise.std_deg) ** 2
    squares[~noise.used] = np.median(squares)
    log_size = np.log(squares + 1e-3 * squares.mean())
    flat = robust.regress(log_size, np.ones((log_size.size, 1)), np.zeros(0), max(1, log_size.size // blocks))
    signs = _signs(flat, seed)
    tested = [p for p in places if p.name in ("turn_rate", "speed", "time")]
    sizes = [replace(p, values=np.abs(p.values), columns=_size_curve(p)) for p in tested]
    p_values = [robust.score_test(flat, [p.columns], signs).p_value for p in sizes]
    found = []
    for place, p_value, excess in zip(
        sizes, p_values, benjamini_hochberg(np.array(p_values), LEVEL), strict=True
    ):
        if excess:
            curve = place.columns @ np.linalg.lstsq(flat.free(place.columns), flat.residual, rcond=None)[0]
            share = float(np.var(curve) / np.var(log_size))
            where = region(place, np.maximum(curve - curve.min(), 0.0))
            found.append(Located(place.name, "variance", where, p_value, share))
    return found


def _size_curve(place: Coordinate) -> Floats:
    """Slopes over the size of a coordinate, shape (rows, 2); a scatter has no sign."""
    x = np.abs(place.values)
    x = (x - x.mean()) / (x.std() or 1.0)
    return np.stack([x, x**2], axis=1)
