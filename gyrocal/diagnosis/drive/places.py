"""Where a drive's difference lives: with what is named, with what has no name, and from when on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from gyrocal.diagnosis.drive.findings import OUT, effect_of, joint_estimate, undecided
from gyrocal.diagnosis.drive.laws import AT_ONCE, SETTLING, Law
from gyrocal.diagnosis.drive.levels import STRANGER_P
from gyrocal.diagnosis.drive.path_strangers import ONE_SIZE
from gyrocal.diagnosis.drive.prior import known_before
from gyrocal.diagnosis.drive.search import YawAnswer
from gyrocal.diagnosis.drive.series import DriveSeries
from gyrocal.diagnosis.drive.sides import uneven_gyro
from gyrocal.diagnosis.drive.truth import TruthAnswer
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Located, NamedEffect
from gyrocal.inference.runs import runs_of
from gyrocal.physics.drive import DRIVE_CATALOGUE, ROBOT_TILT
from gyrocal.units import NORMAL_95, RAD_TO_DEG

#: Noise above what the robot file says by more than this is no noise of that kind.
_NOISY = 4.0


def places(
    series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer | None, effects: list[NamedEffect]
) -> list[Located]:
    """Where the difference lives, the surest first: with the named effects, and where something is left that has no name."""
    # Shares of the gain of what is named; chi-square from p-values would overflow.
    gains = {effect_of(n, yaw): g for n, g in yaw.named.items()}
    whole = max(sum(gains.values()), 1e-300)
    found: dict[str, Located] = {}
    for effect in effects:
        coordinate = DRIVE_CATALOGUE[effect.effect].seen_in
        if coordinate not in found:
            share = gains.get(effect.effect, float("nan")) / whole
            found[coordinate] = Located(coordinate, "mean", effect.p_value, share, finding=effect.effect)
    odd = {c: test.p_value for c, test in yaw.strangers.items() if c in yaw.odd}
    if truth is not None:
        for coordinate, p in truth.odd.items():
            if p < STRANGER_P:
                odd[coordinate] = min(p, odd.get(coordinate, 1.0))
    ratio, granted = (
        yaw.estimate("track")[0] if "track" in yaw.chosen else 0.0,
        known_before(series)["track"][1],
    )
    if undecided(yaw, effects) and abs(ratio) > NORMAL_95 * granted:
        # A ratio of turns that is no name's, and more than the robot file grants.
        odd["turn_rate"] = min(float(stats.chi2.sf(yaw.named["track"], 1)), odd.get("turn_rate", 1.0))
    if any(e.effect == ROBOT_TILT.id for e in effects):
        odd.pop("heading", None)
    left = [Located(c, "mean", p, float("nan"), remains=True) for c, p in odd.items()]
    of_wheels = (("wheels", law.shape["until_s"]) for law in yaw.changed.values())
    target, at_s = next(of_wheels, ("bias", yaw.jump_s))
    if np.isfinite(at_s):
        end_s = float(series.t_s[-1])
        left = [
            replace(one, low=at_s, high=end_s, unit="s", target=target) if one.coordinate == "time" else one
            for one in left
        ]
    return sorted([*found.values(), *left, *_noisy(series, yaw)], key=lambda place: place.p_value)


@dataclass(frozen=True)
class OffInterval:
    """Intervals on end in which the turns are off by more than noise, and that no fit has: when, and by how much, deg."""

    from_s: float
    to_s: float
    turn_deg: float

    def to_json(self) -> dict[str, float]:
        """Entry of ``left_out``; times count from the start of the log."""
        return {"from_s": self.from_s, "to_s": self.to_s, "turn_deg": self.turn_deg}


def left_out(yaw: YawAnswer) -> list[OffInterval]:
    """Slips of a wheel, spikes of the gyro and turns by hand, in order of time; turns of the encoders less those of the gyro."""
    model, off_rad = yaw.model, yaw.left_rad
    nodes = model.frame.nodes
    # Times of nodes are those at which their intervals end.
    ends_s = nodes.t_s - model.frame.series.t_s[0]
    begins_s = ends_s - nodes.dt_s
    return [
        OffInterval(float(begins_s[k[0]]), float(ends_s[k[-1]]), float(RAD_TO_DEG * np.sum(off_rad[k])))
        for k in runs_of(model.outliers)
    ]


def instants(yaw: YawAnswer, truth: TruthAnswer | None) -> list[Remark]:
    """What has no name: how a bias jumps or settles, the gyro's sides differ, a delay grows, track or wheels change."""
    begin_s = yaw.model.frame.series.t_s[0]

    def told(said: Said, unit: float, before: float, std: float, law: Law) -> Remark:
        times = {name: at_s - begin_s for name, at_s in law.shape.items()}
        half = unit * NORMAL_95 * std
        change = -unit * before
        return Remark(said, {"change": change, "least": change - half, "most": change + half} | times)

    found = []
    if "jump" in yaw.chosen:
        found.append(told(Said.BIAS_JUMPS, 1.0, *joint_estimate(yaw, truth, "jump"), yaw.laws["jump"]))
    if yaw.settling:
        found.append(_settles(yaw, truth))
    if "slope" in yaw.named and yaw.time_odds * OUT > 1.0:
        facts = {"odds": yaw.time_odds, "share": 1.0 / (1.0 + yaw.time_odds)}
        found.append(Remark(Said.TEMPERATURE_OR_TIME, facts))
    if truth is not None and (truth.one_size or truth.or_uneven is not None):
        one_size, std = truth.or_uneven or (truth.one_size, truth.stds[ONE_SIZE])
        # What a path lacks of every turn is read too little to the left and too much to the right.
        change, half = -200.0 * one_size, 200.0 * NORMAL_95 * std
        facts = {"change": change, "least": change - half, "most": change + half}
        moving = None if truth.or_uneven is None else joint_estimate(yaw, truth, AT_ONCE)
        beside = {"or_moving_dps": moving or truth.or_moving_dps, "filed": uneven_gyro(truth) is not None}
        found.append(Remark(Said.SIDES_DIFFER, facts | beside | {"told": moving is not None}))
    if "delay" in yaw.odd:
        (grown,), ((variance,),) = yaw.beyond(["delay:0"])
        half = 1e3 * NORMAL_95 * float(np.sqrt(variance))
        change = 1e3 * float(grown)
        facts = {"change": change, "least": change - half, "most": change + half}
        found.append(Remark(Said.DELAY_GROWS, facts))
    for name, law in yaw.changed.items():
        (value,), ((variance,),) = yaw.beyond([name])
        said = Said.TRACK_CHANGES if name.endswith("track") else Said.WHEELS_CHANGE
        found.append(told(said, 100.0, float(value), float(np.sqrt(variance)), law))
    return found


def _settles(yaw: YawAnswer, truth: TruthAnswer | None) -> Remark:
    """By how much the bias changes after the start of a drive, and how fast, by all time constants that may be."""
    beside = [n for n in yaw.fitted if n != yaw.settling]
    gains = {n: yaw.told.added(beside, [n]) for n in SETTLING}
    # That of the fit was the likeliest before the truth was asked.
    likely = [n for n, g in gains.items() if n == yaw.settling or g > max(gains.values()) - NORMAL_95**2]
    by_truth = joint_estimate(yaw, truth, yaw.settling)[0] - yaw.estimate(yaw.settling)[0]
    changes = []
    for name in likely:
        values, covariance = yaw.gram.solve([*beside, name])
        half = NORMAL_95 * float(np.sqrt(covariance[-1, -1]))
        changes += [-float(values[-1]) - by_truth - half, -float(values[-1]) - by_truth + half]
    times_s = list(SETTLING.values())
    # The next time constant that was looked at is outside.
    first, last = (times_s.index(SETTLING[n]) for n in (likely[0], likely[-1]))
    facts = {
        "change": -joint_estimate(yaw, truth, yaw.settling)[0],
        "least": min(changes),
        "most": max(changes),
        "settling_s": SETTLING[yaw.settling],
        "quickest_s": times_s[max(first - 1, 0)],
        "slowest_s": times_s[last + 1] if last + 1 < len(times_s) else None,
    }
    return Remark(Said.BIAS_SETTLES, facts)


def _noisy(series: DriveSeries, yaw: YawAnswer) -> list[Located]:
    """Noise far above what the robot file gives: something lives there that no law here describes.

    Its p-value is that of the level found where the file's is the true one; levels are normal in their logarithm.
    """
    noise, usual, found = yaw.model.noise, yaw.model.usual, []
    given = series.robot.given
    for field, key, coordinate in (
        ("slip_m_per_rt_m", "noise.wheel_slip_m_per_rt_m", "speed"),
        ("turn", "noise.turn_slip_deg_per_rt_deg", "turn_rate"),
    ):
        ratio = getattr(noise, field) / getattr(usual, field)
        if key not in given or ratio <= _NOISY:
            continue
        p = float(stats.norm.sf(np.log(ratio) / yaw.model.log_std[field]))
        if p < STRANGER_P:
            found.append(
                Located(
                    coordinate, "variance", p, float("nan"), remains=True, target="noise", times_given=ratio
                )
            )
    return found
