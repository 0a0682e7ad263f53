"""Laws of the heading difference beside a truth: what it denies of them, adds to them, and makes of their names."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from gyrocal.diagnosis.drive.findings import OUT, joint_estimate, spinning, told_estimate
from gyrocal.diagnosis.drive.improved import figures_of
from gyrocal.diagnosis.drive.jumps import chance, instant_of_p
from gyrocal.diagnosis.drive.laws import AT_ONCE, KINDS, group_of, is_motion, is_slip
from gyrocal.diagnosis.drive.levels import GAIN, STRANGER_P
from gyrocal.diagnosis.drive.motions import AS_LIKELY, likeliest_settling, settling_beats, settling_gain
from gyrocal.diagnosis.drive.nameless import is_odd
from gyrocal.diagnosis.drive.path_laid import ALONE, SCALES
from gyrocal.diagnosis.drive.path_problem import log_chance
from gyrocal.diagnosis.drive.path_strangers import ONE_SIZE
from gyrocal.diagnosis.drive.reckoning import Figures
from gyrocal.diagnosis.drive.search import MOST, YawAnswer
from gyrocal.diagnosis.drive.series import DriveSeries
from gyrocal.diagnosis.drive.sides import sides_of
from gyrocal.diagnosis.drive.truth import BELIEVED, TruthAnswer, Uneven, ask_truth
from gyrocal.diagnosis.model.intervals import RISE_INSTANT_95
from gyrocal.physics.drive import GYRO_SCALE
from gyrocal.units import NORMAL_95

#: Laws of the bias that a truth may show where the encoders alone do not.
_BY_TRUTH = ("slope", "step", AT_ONCE)
#: Drives with a bias that drifts by itself to those with one that goes by the temperature, which most gyros have.
_BY_ITSELF = 0.25
#: Instants at which a truth is asked for a jump of the bias first, and how often three times as closely about the likeliest.
_INSTANTS, _CLOSER = 8, 3


def beside_truth(series: DriveSeries, yaw: YawAnswer) -> tuple[YawAnswer, TruthAnswer | None]:
    """Laws of the heading difference with those that the truth, where there is one, denies or adds, and what it says."""
    yaw, truth = _undenied(series, yaw, _asked(series, yaw))
    if truth is not None and not series.differential:
        truth = _without_unsure(series, yaw, truth)
    if "spinning" in yaw.chosen and spinning(yaw, truth) is None:
        # No wheel goes less far while it drives, nor spins in turns alone.
        yaw = yaw.without(["spinning"], "acceleration")
    if truth is None or truth.mirrored:
        return _slope_or_time(series, yaw, None), truth
    yaw, truth = _jump_at_its_instant(series, yaw, truth)
    # First what the next drive has, too: a jump bends a path much as any of these does.
    yaw, truth = _with_laws(series, yaw, truth)
    jumping, told = _with_jump(series, yaw, truth)
    if jumping is not yaw:
        yaw, truth = _with_laws(series, jumping, told)
    if "jump" in yaw.chosen:
        truth = _scales_beside_the_course(series, yaw, truth)
    held = _slope_or_time(series, yaw, truth)
    if held.chosen != yaw.chosen:
        truth = _asked(series, held, truth) or truth
    yaw, truth = _or_in_motion(series, held, truth)
    return _wheels_beside_structure(_wheels_beside(yaw, truth), truth), truth


def told_from_nothing(
    series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer | None
) -> tuple[YawAnswer, TruthAnswer | None]:
    """Without names of laws whose 95 % interval holds zero, the least sure first: encoders and truth together may say less."""
    while True:
        sure = {n: told_estimate(yaw, truth, n) for n in yaw.named if n != "wheel_cos"}
        stds = {n: abs(value) / std for n, (value, std) in sure.items() if std > 0.0}
        least = min(stds, key=lambda n: stds[n], default="")
        if not least or stds[least] >= NORMAL_95:
            return yaw, truth
        yaw = yaw.gaining({**yaw.named, least: 0.0})
        truth = truth and (_asked(series, yaw, truth) or truth)


def _scales_beside_the_course(series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer) -> TruthAnswer:
    """With scales that hold beside a bias of each part of the drive, of which one jump need not be the whole course."""
    freed = _asked(series, yaw, truth, bias_changes=True)
    if freed is None:
        return truth
    of_scales = {n: freed.values[n] for n in SCALES}
    stds = {n: freed.stds[n] for n in SCALES}
    return replace(
        truth,
        values={**truth.values, **of_scales},
        stds={**truth.stds, **stds},
        covariance=freed.covariance,
    )


def _with_laws(series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer) -> tuple[YawAnswer, TruthAnswer]:
    """With laws of the bias that encoders and truth show together; beside one speed the truth is asked for them anyway."""
    if not series.differential:
        return yaw, truth
    while True:
        tried = [
            (_with_truth(series, yaw, truth, n), n)
            for n in _BY_TRUTH
            if n in yaw.laws and n not in yaw.chosen and n not in yaw.uneven
        ]
        (gain, found), name = max(tried, key=lambda one: one[0][0], default=((0.0, None), ""))
        if found is None or gain < GAIN:
            return yaw, truth
        for other in (n for n in yaw.named if KINDS[n].figure.startswith("bias") and n != "jump"):
            # What was taken first may have stood for this one.
            less = yaw.less([other]).with_law(name, gain)
            alone = _asked(series, less, truth)
            if alone is not None and _with_truth(series, less, alone, other)[0] < AS_LIKELY:
                return less, alone
        yaw, truth = yaw.with_law(name, gain), found


def _slope_or_time(series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer | None) -> YawAnswer:
    """With the odds of a bias that goes by the time to the slope over temperature that is named; without that where they are long.

    A robot that warms up all along has both in one, and the next drive may begin warm.
    """
    if "slope" not in yaw.named or yaw.settling:
        return yaw
    beside = [n for n in yaw.fitted if n != "slope"]
    instead = likeliest_settling(yaw.told, beside, -np.inf)
    if not instead:
        return yaw
    against = settling_gain(yaw.told, beside) - yaw.told.added(beside, ["slope"])
    if truth is not None:
        found = _asked(series, yaw.less(["slope"]).with_law(instead[0], 0.0), truth)
        against += 0.0 if found is None else truth.loss - found.loss
    odds = _BY_ITSELF * float(np.exp(0.5 * min(against, 100.0)))
    return replace(yaw, time_odds=odds) if odds < OUT else yaw.without(["slope"], "time")


def _or_in_motion(series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer) -> tuple[YawAnswer, TruthAnswer]:
    """With a bias in motion that fits a path as well as turns do that are off to one side, where those are what is told.

    More gyros have that bias than such sides, so where it is sure it is told, and those beside it.
    """
    told = [n for n in yaw.chosen if is_motion(n)]
    if not truth.one_size or told or AT_ONCE not in yaw.laws:
        return yaw, truth
    moving = yaw.with_law(AT_ONCE, 0.0)
    found = _asked(series, moving, truth)
    if found is None or found.one_size or not _explained(found, truth):
        return yaw, truth
    uneven = _asked(series, moving, truth, uneven="held")
    if uneven is None or found.loss > uneven.loss + AS_LIKELY:
        return yaw, truth
    value, std = joint_estimate(moving, found, AT_ONCE)
    if abs(value) < BELIEVED * std:
        return yaw, replace(truth, or_moving_dps=(value, std))
    return yaw.with_law(AT_ONCE, (value / std) ** 2), replace(
        found, or_uneven=(truth.one_size, truth.stds[ONE_SIZE])
    )


def _wheels_beside(yaw: YawAnswer, truth: TruthAnswer) -> YawAnswer:
    """With what wheels that differ gain beside the bias that the truth shows: they may have stood for it."""
    if "asymmetry" not in yaw.named:
        return yaw
    value, std = joint_estimate(yaw, truth, "asymmetry")
    return yaw.gaining({**yaw.named, "asymmetry": (value / std) ** 2})


def _wheels_beside_structure(yaw: YawAnswer, truth: TruthAnswer) -> YawAnswer:
    """With what laws of the wheels gain beside what the truth shows the surest that has no name.

    An error of the gyro that is none of the catalogue, as of turns one way, is in the heading difference too, and looks
    like wheels there.
    """
    surest = min(truth.odd, key=lambda c: truth.odd[c], default="")
    if not surest or truth.odd[surest] >= STRANGER_P:
        return yaw
    beside = [*yaw.chosen, *(n for n in yaw.gram.names if n.startswith(f"{surest}:"))]
    of_wheels = [n for n in yaw.named if n in ("track", "asymmetry") or is_slip(n)]
    gains = {n: yaw.told.added([b for b in beside if b != n], [n]) for n in of_wheels}
    return yaw.gaining({n: gains.get(n, gain) for n, gain in yaw.named.items()})


def _with_jump(series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer) -> tuple[YawAnswer, TruthAnswer]:
    """With a jump of the bias that the truth shows where the encoders do not, where it is the time that is oddest.

    A path that such a jump has bent is laid anew for each instant: small errors about a wrong path would not tell it.
    """
    surest = min(truth.odd.values(), default=1.0)
    # Wheels that change bend the path in the mean of both.
    if "jump" in yaw.chosen or yaw.changed or surest >= STRANGER_P or truth.odd["time"] > surest:
        return yaw, truth
    whole_s = float(series.t_s[0]), float(series.t_s[-1])
    best_s, span_s = _likeliest_instant(series, yaw, truth, whole_s)
    wider = yaw.with_jump(instant_of_p(best_s, span_s, truth.odd["time"]))
    found = _asked(series, wider, truth)
    if found is None or found.odd["time"] < truth.odd["time"]:
        return yaw, truth
    # Time may be odd by something else, of which the best instant explains as little as any.
    value, std = joint_estimate(wider, found, "jump")
    return (wider, found) if chance((value / std) ** 2) < STRANGER_P else (yaw, truth)


def _jump_at_its_instant(
    series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer
) -> tuple[YawAnswer, TruthAnswer]:
    """With the jump that the encoders show at the instant, of those they leave open, that is the truth's.

    A path that jumps some seconds early is bent by degrees, and the truth would have jump and scales be others for it.
    """
    if "jump" not in yaw.chosen:
        return yaw, truth
    shape, without = yaw.laws["jump"].shape, yaw.less(["jump"])
    best_s, span_s = _likeliest_instant(series, without, truth, (shape["earliest_s"], shape["latest_s"]))
    jumping = without.with_jump(instant_of_p(best_s, span_s, yaw.strangers["time"].p_value))
    found = _asked(series, jumping, truth)
    return (yaw, truth) if found is None or found.loss >= truth.loss else (jumping, found)


def _likeliest_instant(
    series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer, within_s: tuple[float, float]
) -> tuple[float, tuple[float, float]]:
    """When a jump of the bias fits the truth best, and the 95 % interval of that, s."""
    losses: dict[float, float] = {}

    def look(instants_s: Iterable[float]) -> float:
        for at_s in instants_s:
            losses[at_s] = _loss_with_jump(series, yaw, truth, at_s)
        return min(losses, key=lambda at_s: losses[at_s])

    step_s = (within_s[1] - within_s[0]) / _INSTANTS
    best_s = look(within_s[0] + step_s * (k + 0.5) for k in range(_INSTANTS))
    for _ in range(_CLOSER):
        step_s /= 3.0
        best_s = look([best_s + step_s * k for k in (-2, -1, 1, 2)])
    likely_s = [at_s for at_s, loss in losses.items() if loss < losses[best_s] + RISE_INSTANT_95]
    # The next instant that was looked at is outside.
    return best_s, (max(min(likely_s) - step_s, within_s[0]), min(max(likely_s) + step_s, within_s[1]))


def _loss_with_jump(series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer, at_s: float) -> float:
    """Loss of the path with a bias that jumps at an instant; infinite where the log says nothing of such a jump."""
    jumping = yaw.jumping(at_s)
    told = series.t_s[0] < at_s < series.t_s[-1] and jumping.estimate("jump")[1] > 0.0
    found = _asked(series, jumping, truth) if told else None
    return np.inf if found is None else found.loss


def _without_unsure(series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer) -> TruthAnswer:
    """With what the other figures are without the laws that a truth is asked for beside one speed and is not sure of.

    No robot file gets those, and scales that were told beside one of them would be another gyro's. How well the scales are known
    counts with them.
    """
    asked = [n for n in ALONE if n in truth.values]
    sure = [n for n in asked if truth.told(n) ** 2 >= GAIN]
    found = None if sure == asked else _asked(series, yaw, truth, alone=sure)
    if found is None:
        return truth
    stds = {n: max(std, truth.stds.get(n, 0.0)) for n, std in found.stds.items()}
    return replace(found, stds=stds)


def _taken_out(series: DriveSeries, yaw: YawAnswer) -> Figures:
    """What the encoders know, before the truth is asked."""
    return replace(figures_of(series, yaw, {}, None), bias_from_rest=False)


def _asked(
    series: DriveSeries,
    yaw: YawAnswer,
    near: TruthAnswer | None = None,
    *,
    bias_changes: bool = False,
    alone: Sequence[str] | None = None,
    uneven: Uneven = "asked",
) -> TruthAnswer | None:
    laws = yaw.bias_laws
    groups = {group_of(n) for n in laws.names}
    free = [] if series.differential else [n for n in ALONE if group_of(n) not in groups]
    figures, noise = _taken_out(series, yaw), yaw.model.noise
    # Be it the gyro's or the wheels'.
    turns = sides_of(yaw).sure
    return ask_truth(
        series,
        figures,
        laws,
        noise,
        free if alone is None else alone,
        near,
        bias_changes=bias_changes,
        uneven_turns=turns,
        uneven=uneven if alone is None else "shown",
    )


def _undenied(
    series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer | None
) -> tuple[YawAnswer, TruthAnswer | None]:
    """Without laws of the motion that the truth speaks against.

    What a wheel does can look like a bias that comes with the motion. The path by the gyro that is laid on the truth has no
    wheel in its headings. Without a truth, a wheel that does something over its speed is likelier to have done this, too.
    """
    of_motion = [n for n in yaw.named if is_motion(n)]
    if not of_motion:
        return yaw, truth
    other = yaw.without(of_motion, "speed")
    if truth is None or truth.mirrored:
        return (other if "speed" in yaw.odd else yaw), truth
    instead = _asked(series, other)
    return (other, instead) if instead is not None and _denied(truth, instead) else (yaw, truth)


def _denied(truth: TruthAnswer, without: TruthAnswer) -> bool:
    """Whether a truth speaks against a law: it fits the path better without."""
    return bool(truth.loss - without.loss > 2.0 * np.log(OUT))


def _beats_structure(gain: float, found: TruthAnswer, truth: TruthAnswer, of_encoders: float) -> bool:
    """Whether a law that gains so much is likelier than structure without a name.

    Parameters
    ----------
    found, truth : beside the law, and without it
    of_encoders : logarithm of the chance of the structure that encoders show over the time
    """
    # What fits better and leaves nothing odd is all that was odd; columns without a name gain more by bending with the noise.
    settled = not is_odd(found.surest) and truth.loss - found.loss > AS_LIKELY
    structure = of_encoders if settled else min(truth.surest, of_encoders)
    # What is left without it has swollen the noise that its figure is measured by.
    fits = max(gain, truth.loss - found.loss)
    return not is_odd(structure) or log_chance(fits, 1) < structure


def _with_truth(
    series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer, name: str
) -> tuple[float, TruthAnswer | None]:
    """What another law of the bias gains by encoders and truth together, and what the truth says beside it.

    Structure without a name has to be explained by it, all or most, and better than by itself. A scale of the gyro that is less sure
    beside it than the law is beside the scale may have stood for it, as on a path that turns one way.
    """
    if KINDS[name].group and any(KINDS[n].group == KINDS[name].group for n in yaw.chosen):
        return 0.0, None
    if is_motion(name) and settling_beats(yaw.told, yaw.fitted, name, GAIN):
        return 0.0, None
    wider = yaw.with_law(name, 0.0)
    found = _asked(series, wider, truth)
    if found is None or not _explained(found, truth) or _denied(found, truth):
        return 0.0, None
    (both, both_std), (own, own_std) = joint_estimate(wider, found, name), wider.estimate(name)
    gain = yaw.told.added(yaw.chosen, [name]) + (both / both_std) ** 2 - (own / own_std) ** 2
    # On loops a scale of the turns one way looks like one of all turns and a bias in motion that happen to fit each other.
    if truth.one_way.get("", 0.0) > AS_LIKELY and found.one_way.get(name, -np.inf) > -AS_LIKELY:
        return 0.0, None
    beside = found.told(GYRO_SCALE.id) ** 2
    if truth.believed(GYRO_SCALE.id) and gain > max(beside, 2.0 * np.log(OUT)):
        gain += truth.told(GYRO_SCALE.id) ** 2 - beside
    # Encoders whose difference to the gyro changes with time, as of a wheel that grows, would have it taken for a bias.
    of_encoders = float(np.log(max(yaw.strangers["time"].p_value, np.finfo(float).tiny)))
    better = _beats_structure(gain, found, truth, of_encoders)
    # Turns that are off to one side are in the path that it is laid beside, free: whichever fits better is likelier.
    better |= truth.one_size != 0.0 and truth.loss - found.loss > AS_LIKELY
    return (gain, found) if better else (0.0, None)


def _explained(found: TruthAnswer, before: TruthAnswer) -> bool:
    """Whether nothing is odd any more, or little of what was: of a path bent far something is left by its noise levels."""
    return not is_odd(found.surest) or found.surest >= (1.0 - MOST) * before.surest
