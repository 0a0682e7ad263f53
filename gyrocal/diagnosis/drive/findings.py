"""From fits to names: which effects a drive holds, what else each could be, where it lives, how sure that is."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gyrocal.diagnosis.drive.checks import Found
from gyrocal.diagnosis.drive.laws import AT_ONCE, KINDS, MOVING, PER_SI, SETTLING, Kind, is_motion
from gyrocal.diagnosis.drive.levels import GAIN, STRANGER_P
from gyrocal.diagnosis.drive.path_laid import ALONE, SCALES
from gyrocal.diagnosis.drive.path_strangers import ONE_SIZE, SPINNING
from gyrocal.diagnosis.drive.prior import known_before, may_be_tilted
from gyrocal.diagnosis.drive.search import YawAnswer, other_slips
from gyrocal.diagnosis.drive.series import DriveSeries, usual_step_s
from gyrocal.diagnosis.drive.sides import ratio_of_turns, sides_of
from gyrocal.diagnosis.drive.truth import BELIEVED, UNEVEN, TruthAnswer
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Alternative, Estimate, Located, NamedEffect, Verdict
from gyrocal.physics.drive import (
    BIAS_TEMPERATURE,
    DRIVE_CATALOGUE,
    DROPPED_SAMPLES,
    EARTH_RATE,
    ENCODER_OVERCOUNT,
    GYRO_BIAS,
    GYRO_DELAY,
    GYRO_SCALE,
    ROBOT_TILT,
    SKID_SLIP,
    START_STOP_SLIP,
    UNIT_OR_SIGN,
    WHEEL_ASYMMETRY,
    WHEEL_ECCENTRICITY,
    WHEEL_SCALE,
)
from gyrocal.physics.lacking import Lack, Reason, Why
from gyrocal.units import DPH_TO_DPS, EARTH_RATE_DPH, NORMAL_95, RAD_TO_DEG

Floats = NDArray[np.float64]

#: Evidence against a rival beyond which it is no rival.
OUT = 20.0
#: A track so near to half or twice the true one is a mix-up as likely as a slip.
_MIXED_UP, _MIXED_UP_BY = (0.5, 2.0), 0.1
#: Columns of the heading difference that a slope alone makes: what the gyro lacks of a turn goes by twice the heading.
_TILT = ("heading:2", "heading:3")
#: A scale that the truth knows to less than this is said to be not testable: no maker is as far off.
_KNOWN = 0.02
#: A delay this near to half a row, of a row, may be that of samples: drives thinned to one and two rows a second came within
#: 0.1, a noisier one within 0.2. How often a true delay falls there was not measured.
_HALF_A_ROW = 0.2
#: A ratio of turns is the track's unless another cause is likelier by more than this (3 to 1): of the three it is known least.
_LIKELIER = 2.0 * float(np.log(3.0))
#: Wheels and gyros are seldom off by so much, tracks have been by 130 %: a smaller ratio of turns that the truth
#: leaves open is given no name, for it may be any of the three.
_ANY_SCALE = 0.05
#: By what an error of the gyro's turns or of the way goes that is no scale.
_CHANGES_BY = {GYRO_SCALE.id: "turn_rate", WHEEL_SCALE.id: "speed"}
#: Scales that make the same ratio of encoder turn to gyro turn.
_RATIO = frozenset({SKID_SLIP.id, *SCALES})
#: Effects of which one may have made what the log shows of the other: neither explains it while the log cannot tell.
_ALIKE = (_RATIO, frozenset({GYRO_BIAS.id, BIAS_TEMPERATURE.id}))


@dataclass(frozen=True)
class OfTruth:
    """A figure with its standard deviation, in the unit of its law; scales are relative."""

    value: float
    std: float


def effect_of(name: str, yaw: YawAnswer) -> str:
    """Id of the catalogue of a law's name in the fit."""
    return yaw.laws[name].effect


def estimate(effect: str, value: float, std: float) -> Estimate:
    """Amplitude of an effect in the catalogue's unit, from SI."""
    unit = DRIVE_CATALOGUE[effect].parameters[0].unit
    per = PER_SI[unit]
    return Estimate.normal(per * value, per * std, unit)


def joint_estimate(yaw: YawAnswer, truth: TruthAnswer | None, name: str) -> tuple[float, float]:
    """A law of the heading difference and its standard deviation, with what the truth adds."""
    value, std = yaw.estimate(name)
    if truth is None or truth.mirrored:
        return value, std
    if name not in truth.values:
        return yaw.beside(name, np.array([truth.values[n] for n in yaw.of_bias]), truth.of_laws)
    return value + truth.values[name], truth.stds[name]


def told_estimate(yaw: YawAnswer, truth: TruthAnswer | None, name: str) -> tuple[float, float]:
    """The same with what is open between laws that explain as much."""
    value, std = joint_estimate(yaw, truth, name)
    return (value, float(np.hypot(std, yaw.unsure_of_lag(name)))) if is_motion(name) else (value, std)


def of_truth(yaw: YawAnswer, truth: TruthAnswer | None) -> dict[str, OfTruth]:
    """What the truth shows or has a part in: scales, laws of the bias, the track that is left, wheels that spin."""
    slip = spinning(yaw, truth)
    return _turns_and_way(yaw, truth) | ({} if slip is None else {START_STOP_SLIP.id: slip})


def _turns_and_way(yaw: YawAnswer, truth: TruthAnswer | None) -> dict[str, OfTruth]:
    """What the truth shows, scales of gyro and wheels and laws of the bias (`ALONE`), and the track that is left.

    Encoder turn over gyro turn is (1 + track)(1 + wheels)/(1 + gyro), so that only the truth tells the three apart.
    What it does not show goes to whichever of the three it speaks least against.
    """
    found: dict[str, OfTruth] = {}
    tilt = _tilt(yaw, truth)
    if truth is not None:
        for name in SCALES:
            if truth.believed(name) and not _changes(name, yaw, truth):
                found[name] = OfTruth(truth.values[name], truth.stds[name])
        if "gyro_scale" in found and tilt.value > 0.0:
            beside = found.pop("gyro_scale")
            beside = OfTruth(beside.value + tilt.value, float(np.hypot(beside.std, tilt.std)))
            if abs(beside.value) > BELIEVED * beside.std:
                found["gyro_scale"] = beside
        for name in ALONE:
            if name not in yaw.named and truth.told(name) ** 2 >= GAIN:
                found[name] = OfTruth(truth.values[name], truth.stds[name])
    if tilt.value > 0.0:
        found[ROBOT_TILT.id] = tilt
    if "track" not in yaw.chosen:
        return found
    c, std = ratio_of_turns(yaw, truth)
    if abs(c) < _ANY_SCALE and _turns_are_odd(yaw, truth):
        return found
    if found:
        left = left_of_track(c, std, found)
        if left.value**2 >= GAIN * left.std**2 and "track" not in yaw.uneven:
            found["track"] = left
    elif "track" in yaw.named and c**2 >= GAIN * std**2:
        against = _against(c, std, truth)
        best = min(against, key=lambda n: against[n])
        # Beside a slip law the constant is a part of that law's shape.
        slipping = any(n.startswith("slip_") for n in yaw.named)
        if slipping or against["track"] <= against[best] + _LIKELIER:
            best = "track"
        rivals = [n for n in against if n != best and against[n] < against[best] + 2.0 * np.log(OUT)]
        if rivals and not slipping and abs(c) < _ANY_SCALE:
            return found
        value = {"track": c, "wheel_scale": c, "gyro_scale": 1 / (1 + c) - 1}[best]
        if best == GYRO_SCALE.id:
            std = float(np.hypot(std, UNEVEN * sides_of(yaw).one_sided * value))
        found[best] = OfTruth(value, std)
    return found


def left_of_track(c: float, std: float, shown: Mapping[str, OfTruth]) -> OfTruth:
    """What of a ratio of turns is the track's, less scales and slope that the truth shows; laws of the bias are no part of it."""
    slope, gyro, wheels = (shown[n] if n in shown else OfTruth(0.0, 0.0) for n in (ROBOT_TILT.id, *SCALES))
    left = (1 + c) * (1 - slope.value) * (1 + gyro.value) / (1 + wheels.value) - 1
    return OfTruth(left, float(np.linalg.norm([std, slope.std, gyro.std, wheels.std])))


def spinning(yaw: YawAnswer, truth: TruthAnswer | None) -> OfTruth | None:
    """Share of the way by which wheels spin for each m/s^2 that the speed grows, where turns and way together show it.

    In turns the encoders' heading tells it, on all of the way the truth: two measurements of one figure. Where they deny each
    other the truth is believed: of wheels that both go further by as much, no turn is longer.
    """
    told = []
    if truth is not None and not truth.mirrored and SPINNING in truth.values:
        told.append((truth.values[SPINNING], truth.stds[SPINNING]))
    if "spinning" in yaw.chosen:
        told.append(yaw.estimate("spinning"))
    elif told and "spinning" in yaw.laws:
        # By themselves turns have not told it.
        values, covariance = yaw.beyond([*other_slips(yaw.gram, yaw.fitted), "spinning"])
        told.append((float(values[-1]), float(np.sqrt(covariance[-1, -1]))))
    weights = np.array([std**-2 for _, std in told])
    if not told or not np.isfinite(weights).all():
        return None
    value, std = float(np.average([v for v, _ in told], weights=weights)), float(weights.sum() ** -0.5)
    if stats.chi2.sf(sum(((v - value) / s) ** 2 for v, s in told), 1) < STRANGER_P:
        value, std = told[0]
    return OfTruth(value, std) if value > 0.0 and (value / std) ** 2 >= GAIN else None


def _tilt(yaw: YawAnswer, truth: TruthAnswer | None) -> OfTruth:
    """Share of the turns that a gyro on a slope lacks in the mean; 0 where nothing speaks for one.

    Of a turn over a slope of angle a, w cos(a cos(heading)) is seen: a^2/4 less, and as much by twice the heading. It must
    hold beside all columns without a name, since a path of right angles turns at the same headings each time; but for those
    of places, at each of which a robot may always have the same heading.
    """
    if _TILT[0] not in yaw.gram.names:
        return OfTruth(0.0, 0.0)
    everything = [
        *yaw.chosen,
        *(n for n in yaw.gram.names if ":" in n and not n.startswith((*_TILT, "place"))),
    ]
    values, covariance = (part[-2:] for part in yaw.gram.solve([*everything, *_TILT]))
    covariance = covariance[:, -2:]
    seen = stats.chi2.sf(values @ np.linalg.solve(covariance, values), 2) <= STRANGER_P
    if not seen and not _lacks_by_heading(values, covariance, truth):
        return OfTruth(0.0, 0.0)
    size = float(np.hypot(*values))
    return OfTruth(size, float(np.sqrt(values @ covariance @ values)) / size)


def _lacks_by_heading(values: Floats, covariance: Floats, truth: TruthAnswer | None) -> bool:
    """Whether what the gyro lacks by the truth goes by twice the heading, as its columns have it, rather than not at all.

    The truth tells the size, so that a weak slope shows where its columns alone, without that size, would not.
    """
    if truth is None or not truth.believed("gyro_scale") or truth.values["gyro_scale"] > 0.0:
        return False
    heading = np.linspace(0.0, 2.0 * np.pi, 361)
    sloped = truth.values["gyro_scale"] * np.stack([np.cos(heading), np.sin(heading)])
    precision = np.linalg.inv(covariance)
    level, least = (
        float(np.min(np.einsum("ik,ij,jk->k", away, precision, away)))
        for away in (values[:, None], values[:, None] - sloped)
    )
    return bool(level - least > 2.0 * np.log(OUT))


def _changes(scale: str, yaw: YawAnswer, truth: TruthAnswer) -> bool:
    """Whether what misses the truth is of one way to turn, of some speeds or of some time only: another path has other shares.

    A scale of all turns is none where they differ by as much from the one way to the other.
    """
    if truth.odd.get(_CHANGES_BY[scale], 1.0) < STRANGER_P:
        if scale != GYRO_SCALE.id or not truth.one_size:
            return True
        beyond = abs(truth.values[scale]) - abs(truth.one_size)
        if beyond <= NORMAL_95 * float(np.hypot(truth.stds[scale], truth.stds[ONE_SIZE])):
            return True
    if scale == WHEEL_SCALE.id and yaw.changed:
        return True
    return scale == GYRO_SCALE.id and _goes_by_place(yaw, truth)


def _goes_by_place(yaw: YawAnswer, truth: TruthAnswer) -> bool:
    """Whether what the gyro's turns miss the truth by goes by where the robot is: of a slope it is, of no scale.

    A truth that is too coarse to tell where leaves it to the encoders, where the gyro lacks something of its turns.
    """
    if truth.values["gyro_scale"] < 0.0 and "place" in yaw.odd:
        return True
    surest = min(truth.odd.values(), default=1.0)
    return surest < STRANGER_P and truth.odd.get("place") == surest


def _turns_are_odd(yaw: YawAnswer, truth: TruthAnswer | None) -> bool:
    """Whether the gyro's turns miss the truth in a way that no scale makes: then their ratio tells no track either."""
    if truth is None or truth.mirrored:
        return False
    return _changes(GYRO_SCALE.id, yaw, truth)


def _against(
    c: float, std: float, truth: TruthAnswer | None, taken: Collection[str] = ()
) -> dict[str, float]:
    """Chi-square of the truth against each scale that could make a ratio of the headings, by name.

    Those that are `taken` out of the ratio already, with what the truth says of them, are none that could make the rest.
    """
    cases = {"track": (0.0, 0.0), "gyro_scale": (1 / (1 + c) - 1, 0.0), "wheel_scale": (0.0, c)}
    cases = {name: expected for name, expected in cases.items() if name not in taken}
    free = [k for k, name in enumerate(SCALES) if name not in taken]
    if truth is None or truth.mirrored:
        return dict.fromkeys(cases, 0.0)
    seen = np.array([truth.values[n] for n in SCALES])
    found = {}
    for name, expected in cases.items():
        spread = truth.covariance + np.diag([std**2 * (name == n) for n in SCALES])
        away = (seen - np.array(expected))[free]
        found[name] = float(away @ np.linalg.solve(spread[np.ix_(free, free)], away))
    return found


def named_effects(
    series: DriveSeries,
    yaw: YawAnswer,
    truth: TruthAnswer | None,
    parts: Mapping[str, OfTruth],
    checks: list[Found],
) -> list[NamedEffect]:
    """Everything that earns its name, the strongest first."""
    gains: list[tuple[float, NamedEffect]] = []
    for name, gain in yaw.named.items():
        if name in ("track", "spinning"):
            continue
        gains.append((gain, _of_law(name, gain, yaw, truth)))
    for name, scale in parts.items():
        gain = (scale.value / scale.std) ** 2
        gains.append((gain, _of_scale(name, parts, series, yaw, truth)))
    bias = unexpected_bias(series, yaw, truth)
    if bias is not None and not any(e.effect == GYRO_BIAS.id for _, e in gains):
        gains.append(bias)
    gains.sort(key=lambda item: -item[0])
    effects: list[NamedEffect] = []
    for _, effect in gains:
        # A slip law and what is left of the track are one effect.
        if effect.effect not in [e.effect for e in effects]:
            effects.append(effect)
    facts = [_effect(f.effect, {"amplitude": f.amplitude}, 1e-16, (), f.seen) for f in checks]
    return [
        *(f for f in facts if f.effect == UNIT_OR_SIGN.id),
        *effects,
        *(f for f in facts if f.effect != UNIT_OR_SIGN.id),
    ]


def _effect(
    effect: str,
    parameters: Mapping[str, Estimate],
    p: float,
    others: tuple[Alternative, ...],
    seen: Remark | None = None,
    beside: Remark | None = None,
) -> NamedEffect:
    law = DRIVE_CATALOGUE[effect]
    return NamedEffect(effect, law.family, parameters, p, others, None, law.runtime, seen=seen, beside=beside)


def _of_law(name: str, gain: float, yaw: YawAnswer, truth: TruthAnswer | None) -> NamedEffect:
    law = yaw.laws[name]
    value, std = told_estimate(yaw, truth, name)
    seen, beside, degrees = _said(name, value), None, 1
    if name == "wheel_cos":
        other, _ = yaw.estimate("wheel_sin")
        value, degrees = float(np.hypot(value, other)), 2
        side = "right" if law.shape["side"] > 0 else "left"
        radius = law.shape["wheel_radius_m"]
        seen = Remark(Said.WHEEL_TURN, {"side": side, "way_m": 2 * np.pi * radius, "radius_m": radius})
    parameters = {"amplitude": estimate(law.effect, value, std)}
    units = {p.name: p.unit for p in DRIVE_CATALOGUE[law.effect].parameters}
    parameters |= {n: Estimate.exact(v, units[n]) for n, v in law.shape.items() if n != "phase_rad"}
    half_row_s = 0.5 * usual_step_s(yaw.model.frame.series.t_s)
    if name == "delay" and abs(value + half_row_s) < 2.0 * _HALF_A_ROW * half_row_s:
        # Early by half a row, as the sample at the end of a row is of the mean over it.
        seen = Remark(Said.SAMPLES_OF_ROWS)
    elif name == "delay" and value > 0.0 and half_row_s > std:
        beside = Remark(Said.MEANS_OF_ROWS, {"half_row_s": half_row_s})
    if name == "delay" and yaw.window_s > 0:
        parameters["encoder_window_s"] = Estimate.exact(yaw.window_s, "s")
    if name in MOVING:
        parameters["time_constant_s"] = Estimate.exact(KINDS[name].lag_s, "s")
    p = float(stats.chi2.sf(gain, degrees))
    return _effect(law.effect, parameters, p, _rivals(name, yaw, truth), seen, beside)


def _said(name: str, value: float) -> Remark | None:
    """What is said of a law of some size where it is named."""
    kind = KINDS.get(name, Kind(name))
    said = kind.said or (kind.said_below_zero if value < 0 else None)
    return None if said is None else Remark(said)


def _rivals(name: str, yaw: YawAnswer, truth: TruthAnswer | None) -> tuple[Alternative, ...]:
    """Laws that would do about as well in its place.

    A bias that settles is none where a truth would show the time as odd. A delay that was taken out beforehand has none, nor
    have the encoders any for what they do not show by themselves.
    """
    others = [n for n in yaw.fitted if n != name]
    own = yaw.told.added(others, [name])
    if own < GAIN or (name == "delay" and yaw.ahead_s != 0.0):
        return ()
    found: dict[str, float] = {}
    told = truth is not None and not truth.mirrored
    for other, law in yaw.laws.items():
        if (
            other in yaw.fitted
            or (told and other in SETTLING)
            or law.effect == yaw.laws[name].effect
            or other.startswith("wheel_")
        ):
            continue
        ratio = float(np.exp(np.clip(0.5 * (own - yaw.told.added(others, [other])), -50, 50)))
        if ratio < OUT:
            found[law.effect] = min(ratio, found.get(law.effect, np.inf))
    if name == "asymmetry" and not yaw.model.frame.nodes.resting.any():
        found[GYRO_BIAS.id] = 1.0
    if name == "slope" and yaw.time_odds * OUT > 1.0:
        found[GYRO_BIAS.id] = 1.0 / yaw.time_odds
    return tuple(Alternative(e, r) for e, r in sorted(found.items(), key=lambda x: x[1]))


def _of_scale(
    name: str, parts: Mapping[str, OfTruth], series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer | None
) -> NamedEffect:
    scale = parts[name]
    effect = {"track": SKID_SLIP.id, "slope": BIAS_TEMPERATURE.id, AT_ONCE: GYRO_BIAS.id}.get(name, name)
    seen, beside = _said(name, scale.value), None
    others: dict[str, float] = {}
    if name == ROBOT_TILT.id:
        tilt = 2.0 * RAD_TO_DEG * float(np.sqrt(scale.value))
        parameters = {"amplitude": Estimate.normal(tilt, 0.5 * tilt * scale.std / scale.value, "deg")}
    else:
        parameters = {"amplitude": estimate(effect, scale.value, scale.std)}
    if name == "track":
        parameters |= {"law": Estimate.exact(0.0, "1"), "shape": Estimate.exact(0.0, "1")}
        widened = max(1 + scale.value, 1e-9)
        if any(abs(np.log(widened / f)) < _MIXED_UP_BY for f in _MIXED_UP):
            others[UNIT_OR_SIGN.id] = 1.0
            beside = Remark(Said.TRACK_MIXED_UP)
    if name == "track" or (name in SCALES and (truth is None or not truth.believed(name))):
        ratio = (scale.value, scale.std) if name == "track" else yaw.estimate("track")
        against = _against(*ratio, truth, [n for n in SCALES if n in parts and n != name])
        for other, chi2 in against.items():
            odds = float(np.exp(np.clip(0.5 * (chi2 - against[name]), -50, 50)))
            if other != name and odds < OUT:
                others[SKID_SLIP.id if other == "track" else other] = odds
    if name == "gyro_scale" and may_be_tilted(series, scale.value):
        others[ROBOT_TILT.id] = 1.0
    if name == "wheel_scale" and scale.value > 0:
        others[ENCODER_OVERCOUNT.id] = 1.0
    p = float(2 * stats.norm.sf(abs(scale.value) / scale.std))
    alternatives = tuple(Alternative(e, r) for e, r in others.items())
    return _effect(effect, parameters, max(p, 1e-300), alternatives, seen, beside)


def unexpected_bias(
    series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer | None
) -> tuple[float, NamedEffect] | None:
    """A constant bias, where no rest takes it off, that is off from what is known of it by more than that grants."""
    if series.rested:
        return None
    value, std = joint_estimate(yaw, truth, "bias")
    expected, granted = known_before(series)["bias"]
    away = value - expected
    gain = (away / std) ** 2
    if gain < GAIN or abs(away) < BELIEVED * float(np.hypot(granted, std)):
        return None
    parameters = {"amplitude": estimate(GYRO_BIAS.id, value, std)}
    others = (Alternative(EARTH_RATE.id, 1.0),) if abs(value) < EARTH_RATE_DPH * DPH_TO_DPS else ()
    p = float(stats.chi2.sf(gain, 1))
    return gain, _effect(GYRO_BIAS.id, parameters, p, others, Remark(Said.BIAS_NO_REST))


def undecided(yaw: YawAnswer, effects: Sequence[NamedEffect]) -> bool:
    """Whether encoders and gyro turn by a ratio of which the log does not say whose it is."""
    return "track" in yaw.named and _RATIO.isdisjoint(e.effect for e in effects)


def verdict(effects: list[NamedEffect], located: list[Located]) -> Verdict:
    """`consistent` only where nothing is named and nothing is left, `explained` only where nothing is left.

    Nor is a ratio of the headings explained by one of the scales that make it while the log cannot exclude the others, or a
    bias that may have come with the motion or with the temperature.
    """
    remains = any(place.remains for place in located)
    physics = [e for e in effects if e.effect != DROPPED_SAMPLES.id]
    if physics:
        return "partly_explained" if remains or any(_may_be_another(e) for e in physics) else "explained"
    return "unexplained" if remains else "consistent"


def _may_be_another(effect: NamedEffect) -> bool:
    others = {other.effect for other in effect.alternatives}
    return any(effect.effect in alike and not others.isdisjoint(alike) for alike in _ALIKE)


def not_testable(
    series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer | None, named: Collection[str] = ()
) -> dict[str, Reason]:
    """Effects that the log may hold and cannot show, with the reason; not of what was `named` all the same."""
    reasons: dict[str, Reason] = {
        ROBOT_TILT.id: Lack(Why.NO_INCLINATION),
        EARTH_RATE.id: Lack(Why.LIKE_GYRO_BIAS),
        START_STOP_SLIP.id: Lack(Why.MOMENTS_ONLY),
        ENCODER_OVERCOUNT.id: Lack(Why.SINGLE_BUMPS),
    }
    if _tilt(yaw, truth).value > 0.0:
        del reasons[ROBOT_TILT.id]
    if spinning(yaw, truth) is not None:
        del reasons[START_STOP_SLIP.id]
    if "slope" not in yaw.laws:
        reasons[BIAS_TEMPERATURE.id] = Lack(Why.NO_GYRO_TEMPERATURE)
    if "step" not in yaw.laws:
        reasons[GYRO_BIAS.id] = Lack(Why.NO_REST_AT_START)
    if not series.differential:
        for effect in (SKID_SLIP, WHEEL_ASYMMETRY, WHEEL_ECCENTRICITY, GYRO_DELAY):
            reasons[effect.id] = Lack(Why.ONE_SPEED)
    for name, like in zip(SCALES, (Why.LIKE_SEPARATION, Why.LIKE_WAY), strict=True):
        if truth is None or not truth.shows(name):
            reasons[name] = Lack(like)
        elif truth.stds[name] > _KNOWN:
            reasons[name] = Lack(Why.POOR_TRUTH, {"percent": 100.0 * truth.stds[name]})
    return {effect: why for effect, why in reasons.items() if effect not in named}
