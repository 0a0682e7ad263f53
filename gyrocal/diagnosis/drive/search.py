"""Which laws a log holds: alignment in time, forward selection by gain, and what has no name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gyrocal.diagnosis.drive.alignment import align
from gyrocal.diagnosis.drive.asked import Asked
from gyrocal.diagnosis.drive.jumps import Instant, chance, jump_of, law_at, less
from gyrocal.diagnosis.drive.lasting import events, outlasting, undenied
from gyrocal.diagnosis.drive.laws import (
    KINDS,
    SETTLING,
    BiasLaws,
    Law,
    group_of,
    is_motion,
    is_slip,
    jump,
    settling_laws,
    strangers,
)
from gyrocal.diagnosis.drive.levels import GAIN, STRANGER_P
from gyrocal.diagnosis.drive.motions import (
    likely_motions,
    may_be_another,
    of_motion,
    rather_than_wheels,
    temperature_for_motion,
    with_central_lag,
    with_settling,
)
from gyrocal.diagnosis.drive.nameless import GainTest, beside_means, nameless, odder, unhidden
from gyrocal.diagnosis.drive.prior import ASYMMETRY_CHANGES, known_before, widened
from gyrocal.diagnosis.drive.series import NODE_S, DriveSeries
from gyrocal.diagnosis.drive.weighing import Evidence, Gram, evidence, gram_of
from gyrocal.diagnosis.drive.wheels import wheel_out_of_true
from gyrocal.diagnosis.drive.yaw import YawModel, yaw_model

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Beside a law of slip another must gain this share of what that gains, too.
SECOND = 0.02
#: Groups of laws of slip.
_SLIPS = ("slip", "spinning")
#: What two laws must gain together that alone gain nothing: as improbable by chance as one's gain.
PAIR_GAIN = float(stats.chi2.isf(stats.chi2.sf(GAIN, 1), 2))
#: Share of what it explains together with columns of no name from which on a law does not need their leave.
MOST = 0.9
#: A delay beyond this part of a node is taken out, and the rest estimated again, so often at the most.
_SHIFT, _ROUNDS = 0.2, 3
_NO_INTERVALS: Ints = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class YawAnswer:
    """Laws of the heading difference.

    Attributes
    ----------
    model, laws : noise, and every law that was looked at
    chosen : names of the laws in the final fit, the constant ones always
    values, covariance : their coefficients, SI (rates of the gyro in deg/s), then those of `nameless`
    named : law -> gain, of those that earn their name
    strangers : coordinate -> test of columns without a name
    odd : coordinates located by them
    told : what all laws gain beside each other, with what was known beforehand
    ahead_s, window_s : delay and window of the encoders that were taken out before the fit
    known : what was known of coefficients beforehand: mean and standard deviation of each
    uneven : laws that change between the parts of the drive, or at an instant: the next drive has others
    changed : track or wheels until the instant from which on they are others, named ``time:`` and the law
    nameless : columns of no name in which something lives, beside which the laws have these coefficients
    time_odds : of a bias that goes by the time to one that goes by the temperature, where that is named
    """

    model: YawModel
    laws: Mapping[str, Law]
    chosen: tuple[str, ...]
    values: Floats
    covariance: Floats
    named: Mapping[str, float]
    strangers: Mapping[str, GainTest]
    odd: tuple[str, ...]
    ahead_s: float
    window_s: float
    told: Evidence
    known: Mapping[str, tuple[float, float]]
    uneven: frozenset[str]
    changed: Mapping[str, Law]
    nameless: Mapping[str, Floats]
    time_odds: float = 0.0

    @property
    def gram(self) -> Gram:
        """All tests of the log at the level of 1/f noise that was found."""
        return self.told.own

    @property
    def fitted(self) -> tuple[str, ...]:
        """All columns of the final fit: the laws, then those without a name."""
        return (*self.chosen, *self.nameless)

    def solved(self, chosen: tuple[str, ...], named: Mapping[str, float]) -> YawAnswer:
        """The same with other laws."""
        values, covariance = self.gram.solve([*chosen, *self.nameless])
        return replace(self, chosen=chosen, values=values, covariance=covariance, named=named)

    def with_law(self, name: str, gain: float) -> YawAnswer:
        """The same with one law more, which something else shows."""
        return self.solved((*self.chosen, name), {**self.named, name: gain})

    @property
    def passing(self) -> list[str]:
        """Laws of a bias that jumps or settles, of which a log is asked when all others were chosen."""
        return [n for n in self.chosen if n == "jump" or n in SETTLING]

    def beyond_candidates(self, blocks: Mapping[str, Floats]) -> list[Floats]:
        """What else was found than a log is asked for first: columns of coordinates that are odd, and laws of `passing`."""
        by_coordinate = [x for c in self.odd if c in blocks for x in blocks[c].T] if self.nameless else []
        return [*by_coordinate, *(self.laws[n].column for n in self.passing)]

    def beyond(self, more: Sequence[str]) -> tuple[Floats, Floats]:
        """Coefficients of columns that are not in the final fit, added to it, and their covariance."""
        values, covariance = self.gram.solve([*(n for n in self.fitted if n not in more), *more])
        return values[-len(more) :], covariance[-len(more) :, -len(more) :]

    def estimate(self, name: str) -> tuple[float, float]:
        """Value and standard deviation of a law's coefficient, SI; a delay with what was taken out before."""
        at = self.chosen.index(name)
        value = float(self.values[at]) + (self.ahead_s if name == "delay" else 0.0)
        return value, float(np.sqrt(max(self.covariance[at, at], 0.0)))

    def beside(self, name: str, moved: Floats, covariance: Floats) -> tuple[float, float]:
        """A law's coefficient and its standard deviation where something else knows the laws of the bias better.

        Parameters
        ----------
        moved : ndarray, shape (p,)
            What that adds to the coefficients of `of_bias`.
        covariance : ndarray, shape (p, p)
            Of these, with what it knows.
        """
        of_bias = [self.chosen.index(n) for n in self.of_bias]
        here = self.covariance[np.ix_(of_bias, of_bias)]
        share = np.linalg.solve(here, self.covariance[of_bias, self.chosen.index(name)])
        value, std = self.estimate(name)
        variance = std**2 - float(share @ (here - covariance) @ share)
        return value + float(share @ moved), float(np.sqrt(max(variance, 0.0)))

    def law_rad(self, name: str) -> Floats:
        """What a law adds to the difference in each interval."""
        return np.asarray(self.values[self.chosen.index(name)] * self.laws[name].column)

    @property
    def settling(self) -> str:
        """The law of a bias that settles after the start; empty where there is none."""
        return next((n for n in self.chosen if n in SETTLING), "")

    @property
    def jump_s(self) -> float:
        """When the bias jumps; before all rows where it does not."""
        return self.laws["jump"].shape["until_s"] if "jump" in self.chosen else -np.inf

    def unsure_of_lag(self, name: str) -> float:
        """How far a bias in motion is from what it would be by the other laws of the motion (rms), by how likely these are.

        Where the encoders do not show it by themselves, they have nothing to say of its lag.
        """
        # A jump that is tried at an instant is none of the laws that were looked at.
        chosen = [n for n in self.fitted if n in self.gram.names]
        if _gain(self.told, chosen, name) < GAIN:
            return 0.0
        motions = of_motion(self.laws)
        likely, values = likely_motions(self.told, chosen, motions)
        return float(np.sqrt(likely @ (values - values[motions.index(name)]) ** 2))

    def settles(self, name: str) -> bool:
        """Whether a bias that settles after the start may have made the log as well as a law of the motion that it names."""
        beside = [n for n in self.fitted if n != name]
        instead = [n for n in self.laws if n in SETTLING]
        return is_motion(name) and may_be_another(self.told, beside, name, instead)

    @property
    def of_bias(self) -> tuple[str, ...]:
        """Names of the laws of the gyro's bias."""
        return tuple(n for n in self.chosen if KINDS[n].figure.startswith("bias"))

    @property
    def bias_laws(self) -> BiasLaws:
        """The laws of the gyro's bias, as the heading difference knows them."""
        at = [self.chosen.index(n) for n in self.of_bias]
        laws = [self.laws[n].column for n in self.chosen]
        columns = np.column_stack([*laws, *self.nameless.values()])
        return BiasLaws(
            self.of_bias,
            self.covariance[np.ix_(at, at)],
            self.model.frame.nodes.t_s,
            (self.model.given(columns).inverse() @ self.covariance[:, at]).T,
        )

    def jumping(self, at_s: float) -> YawAnswer:
        """Coefficients, and what they are known to, if the bias jumped at an instant; all else as it is.

        Nothing is known of a bias beforehand that jumps: held to it, one that is off would be a jump near the end.
        """
        laws = {**self.laws, "jump": jump(self.model.frame, at_s)}
        chosen = (*self.chosen, "jump")
        columns = {n: laws[n].column for n in chosen} | dict(self.nameless)
        known = less(self.known, "bias")
        values, covariance = gram_of(self.model, columns).knowing(known).solve(list(columns))
        return replace(self, laws=laws, chosen=chosen, values=values, covariance=covariance)

    def with_jump(self, instant: Instant) -> YawAnswer:
        """The same with a jump of the bias that something else shows."""
        frame = self.model.frame
        laws = {**self.laws, "jump": law_at(frame, instant)}
        columns = _columns_of(laws, strangers(frame)) | dict(self.nameless)
        known = less(self.known, "bias")
        told = evidence(self.model, columns).knowing(known)
        chosen = (*self.chosen, "jump")
        # A law that stood for the jump has less to say beside it; delays and wheels out of true look like no jump.
        gains = {
            n: g if n in ("delay", "wheel_cos") else _gain(told, chosen, n) for n, g in self.named.items()
        }
        jumping = replace(
            self,
            laws=laws,
            told=told,
            known=known,
            chosen=chosen,
            strangers=odder(self.strangers, "time", GainTest(instant.gain, 1, instant.p_value)),
            odd=tuple(dict.fromkeys([*self.odd, "time"])),
        )
        return jumping.gaining(gains)

    def gaining(self, gains: Mapping[str, float]) -> YawAnswer:
        """The same with what its named laws gain beside something new: one that lost its gain has no name any more."""
        lost = [n for n, gain in gains.items() if gain < GAIN]
        kept = self.less([n for n in lost if n not in ("track", "asymmetry")])
        return replace(kept, named={n: gain for n, gain in gains.items() if n not in lost})

    def less(self, laws: Sequence[str]) -> YawAnswer:
        """The same with some laws less."""
        chosen = tuple(n for n in self.chosen if n not in laws)
        return self.solved(chosen, {n: g for n, g in self.named.items() if n not in laws})

    def without(self, denied: Sequence[str], coordinate: str) -> YawAnswer:
        """The same less laws that something else speaks against: what they had explained has no name but its coordinate."""
        test = GainTest.of(sum(self.named[n] for n in denied), len(denied))
        odd = tuple(dict.fromkeys([*self.odd, coordinate]))
        return replace(self.less(denied), strangers=odder(self.strangers, coordinate, test), odd=odd)

    def spokesman(self, name: str) -> str:
        """Of laws that stand for each other the one that is told: the one of the fit, or the first."""
        alike = [n for n in self.laws if group_of(n) == group_of(name)]
        return next((n for n in alike if n in self.chosen), alike[0])

    @property
    def left_rad(self) -> Floats:
        """Difference of each interval that no law explains."""
        y = self.model.y.copy()
        for name in self.chosen:
            y -= self.law_rad(name)
        return y


def examine_yaw(series: DriveSeries) -> YawAnswer:
    """Fit noise and laws to a log, delays first."""
    ahead_s, window_s = align(series) if series.differential else (0.0, 0.0)
    for _ in range(_ROUNDS):
        asked = Asked.of(series, ahead_s, window_s)
        answer = _examine(asked)
        if "delay" not in answer.chosen:
            break
        rest_s = answer.values[answer.chosen.index("delay")]
        if abs(rest_s) < _SHIFT * max(NODE_S, window_s):
            break
        ahead_s += float(rest_s)
    else:
        asked = Asked.of(series, ahead_s, window_s)
    # What has no name would swell the noise, the gyro's as well as the wheels', as a law would that is not in the mean; but
    # for wheels that change at an instant, which are no columns of a coordinate.
    if not answer.changed and (answer.nameless or answer.passing):
        # Columns without a name are never quite what lives there: what gains beside them alone is their misfit.
        candidates = _of_groups(asked.laws, answer.named if answer.nameless else asked.laws)
        asked = asked.beside(answer.beyond_candidates(asked.blocks), candidates)
        answer = _examine(asked)
    named = "asymmetry" in answer.named
    rather = rather_than_wheels(answer.told, answer.fitted, answer.laws, GAIN) if named else []
    if not rather:
        return answer
    moving = _examine(asked, {"asymmetry": (0.0, ASYMMETRY_CHANGES)})
    return moving if any(n in rather for n in moving.named) else answer


def _examine(
    asked: Asked, held: Mapping[str, tuple[float, float]] | None = None, aside: Ints = _NO_INTERVALS
) -> YawAnswer:
    series, frame, ahead_s = asked.series, asked.frame, asked.ahead_s
    constant, blocks, candidates = asked.constant, asked.blocks, asked.candidates
    model = yaw_model(asked.noise, aside)
    everything = {**constant, **asked.laws, **settling_laws(frame)}
    free = evidence(model, columns := _columns_of(everything, blocks))
    least = [*constant, *(["delay"] if ahead_s != 0.0 else [])]
    known, told, chosen = _first(series, free, known_before(series) | dict(held or {}), least, candidates)
    jumping = jump_of(model, free, everything, chosen, known)
    # What is known of wheels holds at neither side of an instant from which on they are others.
    known = {n: k for n, k in known.items() if f"time:{n}" not in jumping}
    beyond = wheel_out_of_true(frame, model, everything, chosen, known)
    beyond |= {n: x for n, x in jumping.items() if n in KINDS}
    if beyond or jumping:
        everything |= beyond
        columns |= {name: x.column for name, x in (beyond | jumping).items()}
        free = evidence(model, columns)
        told = free.knowing(known)
        chosen = _selected(told, [*least, *beyond], candidates)
    chosen, settled = _of_bias(told, chosen, candidates)
    odd, changed = nameless(free, chosen, jumping, blocks)
    beside = [n for n in columns if ":" in n and odd[n.split(":")[0]].p_value < STRANGER_P]
    chosen, odd = _with_sure_jump(told, chosen, beside, odd)
    earned = _named(told, chosen, beside, ahead_s)
    named, odd = undenied(model, told, everything, [*chosen, *beside], earned, odd)
    named, changing = outlasting(model, everything, chosen, named)
    at_once = events(model, {n: columns[n] for n in (*chosen, *beside)}, known, named)
    if at_once.size:
        return _examine(asked, held, np.union1d(aside, at_once))
    chosen = [n for n in chosen if _pair_of(n) in {*constant, "delay", "jump", *named, *SETTLING}]
    free, unnamed = beside_means(free, columns, chosen, beside, jumping)
    told = free.knowing(known)
    lost = [n for n in chosen if n in SETTLING and _gain(told, [*chosen, *unnamed], n) < GAIN]
    chosen = [n for n in chosen if n not in lost]
    odd = odder(odd, "time", *changing.values(), *settled.values())
    return YawAnswer(
        model,
        everything,
        tuple(chosen),
        *told.own.solve([*chosen, *unnamed]),
        named,
        odd,
        tuple(c for c, test in odd.items() if test.p_value < STRANGER_P),
        ahead_s,
        asked.window_s,
        told,
        known,
        _unlike(changing, ahead_s, jumping).union(settled, earned.keys() - named.keys()),
        unhidden(told, [*chosen, *unnamed], changed),
        unnamed,
    )


def _of_bias(
    told: Evidence, chosen: Sequence[str], candidates: Sequence[str]
) -> tuple[list[str], dict[str, GainTest]]:
    """Laws with those of the bias that are likeliest; and those that one settling by itself stands for, with the test of that."""
    taken = temperature_for_motion(told, with_central_lag(told, chosen, of_motion(candidates)), candidates)
    found = with_settling(told, taken)
    tests = [GainTest.of(_gain(told, found, n)) for n in found if n in SETTLING]
    return found, {n: test for test in tests for n in taken if n not in found}


def _unlike(changing: Iterable[str], ahead_s: float, jumping: Iterable[str]) -> frozenset[str]:
    """Laws that change, or at an instant; of a delay that was taken out beforehand it is what is left of it that does."""
    at_once = {n.removeprefix("time:") for n in jumping}
    return frozenset(at_once.union(n for n in changing if n != "delay" or ahead_s == 0.0))


def _first(
    series: DriveSeries,
    free: Evidence,
    known: Mapping[str, tuple[float, float]],
    least: Sequence[str],
    candidates: Sequence[str],
) -> tuple[Mapping[str, tuple[float, float]], Evidence, list[str]]:
    """What is known beforehand as the drive makes it likeliest, the evidence with that, and the laws that are chosen."""
    told = free.knowing(known)
    chosen = _selected(told, least, candidates)
    if (wider := widened(series, known, free.own, chosen)) == known:
        return known, told, chosen
    told = free.knowing(wider)
    return wider, told, _selected(told, least, candidates)


def _with_sure_jump(
    told: Evidence, chosen: Sequence[str], beside: Sequence[str], odd: Mapping[str, GainTest]
) -> tuple[list[str], dict[str, GainTest]]:
    """Laws and tests, with a jump of the bias only where it holds beside what has no name."""
    if "jump" not in chosen:
        return list(chosen), dict(odd)
    gain = _gain(told, [*chosen, *beside], "jump")
    if chance(gain) < STRANGER_P:
        return list(chosen), odder(odd, "time", GainTest(gain, 1, chance(gain)))
    return [n for n in chosen if n != "jump"], dict(odd)


def _columns_of(laws: Mapping[str, Law], blocks: Mapping[str, Floats]) -> dict[str, Floats]:
    """Columns of laws by their names, and of those without one by coordinate and number."""
    unnamed = {f"{c}:{k}": block[:, k] for c, block in blocks.items() for k in range(block.shape[1])}
    return {n: x.column for n, x in laws.items()} | unnamed


def _of_groups(laws: Iterable[str], of: Iterable[str]) -> list[str]:
    """Laws that stand for one of others."""
    groups = {group_of(n) for n in of}
    return [n for n in laws if group_of(n) in groups]


def _pair_of(name: str) -> str:
    """The law that stands and falls with this one."""
    return "wheel_cos" if name == "wheel_sin" else name


def _gain(told: Evidence, chosen: Sequence[str], name: str) -> float:
    return told.added([n for n in chosen if n != name], [name])


def _delay_gain(gram: Gram, chosen: Sequence[str], ahead_s: float) -> float:
    """What a delay gains that was taken out beforehand, with what is left of it."""
    if "delay" not in chosen:
        return 0.0
    values, covariance = gram.solve(chosen)
    at = list(chosen).index("delay")
    return float((values[at] + ahead_s) ** 2 / covariance[at, at])


def _selected(told: Evidence, first: Sequence[str], candidates: Sequence[str]) -> list[str]:
    """Forward selection by gain, then whatever lost its gain beside the others is taken out again."""
    chosen = list(first)
    gained: dict[str, float] = {}
    for _ in candidates:
        groups = {group_of(n) for n in chosen}
        gains = {
            n: _gain(told, chosen, n) for n in candidates if n not in chosen and group_of(n) not in groups
        }
        best = max(gains, key=lambda n: gains[n], default=None)
        if best is None or gains[best] < _least(gained):
            pair = _cancelling(told, chosen, list(gains))
            if not pair:
                break
            chosen += pair
            continue
        chosen.append(best)
        gained[best] = gains[best]
    return [n for n in chosen if n in first or _gain(told, chosen, n) >= _least(gained)]


def _cancelling(told: Evidence, chosen: Sequence[str], candidates: Sequence[str]) -> list[str]:
    """Two laws of the bias that hide each other, as a step up and a slope down do."""
    of_bias = [n for n in candidates if KINDS[n].figure.startswith("bias")]
    pairs = [pair for pair in combinations(of_bias, 2) if group_of(pair[0]) != group_of(pair[1])]
    gains = {pair: told.added(chosen, pair) for pair in pairs}
    best = max(gains, key=lambda pair: gains[pair], default=())
    return [*best] if best and gains[best] >= PAIR_GAIN else []


def _least(gained: Mapping[str, float]) -> float:
    """What a law must gain beside others: the shape of a slip law is never quite that of the robot's, all else is linear."""
    return max(GAIN, SECOND * max((g for n, g in gained.items() if KINDS[n].group in _SLIPS), default=0.0))


def other_slips(gram: Gram, fitted: Sequence[str]) -> list[str]:
    """Laws of slip beside those of a fit, for whatever goes by how the speed grows.

    Slip has many shapes, and what its law misses of it looks like wheels that slip more in some turns than in others.
    """
    return [n for n in gram.names if n in KINDS and is_slip(n) and n not in fitted]


def _named(told: Evidence, chosen: Sequence[str], beside: Sequence[str], ahead_s: float) -> dict[str, float]:
    """Gain of each law that earns its name, the strongest first; `beside` are columns without one."""
    everything = [*chosen, *beside]
    tested = [n for n in chosen if n not in ("bias", "delay", "jump", "wheel_sin", *SETTLING)]
    gains = {n: _gain(told, everything, n) for n in tested}
    if "spinning" in gains:
        gains["spinning"] = _gain(told, [*everything, *other_slips(told.own, everything)], "spinning")
    # Where a law of the turns explains nearly all that it and columns without a name do together, these are its misfit.
    of_turns = [n for n in tested if n == "track" or is_slip(n)]
    for name in (n for n in of_turns if beside and gains[n] < GAIN):
        alone, others = _gain(told, chosen, name), [n for n in chosen if n != name]
        if alone >= MOST * told.added(others, [name, *beside]):
            gains[name] = alone
    if "wheel_cos" in chosen:
        others = [n for n in everything if _pair_of(n) != "wheel_cos"]
        gains["wheel_cos"] = told.added(others, ["wheel_cos", "wheel_sin"])
    if "delay" in chosen:
        gains["delay"] = _delay_gain(told.own, everything, ahead_s)
    named = {n: g for n, g in gains.items() if g >= (GAIN if is_slip(n) else _least(gains))}
    return dict(sorted(named.items(), key=lambda item: -item[1]))
