"""What a drive tells the next one: what should be taken out of its log, and the robot file with what earned it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from gyrocal.diagnosis.drive.filed import asked_anew, beyond_given
from gyrocal.diagnosis.drive.findings import (
    OfTruth,
    joint_estimate,
    told_estimate,
)
from gyrocal.diagnosis.drive.laws import (
    KINDS,
    MOVING,
    SETTLING,
    is_slip,
    reference_temp_c,
    settling,
    strangers,
)
from gyrocal.diagnosis.drive.motions import of_motion, or_nothing
from gyrocal.diagnosis.drive.path_laid import SCALES
from gyrocal.diagnosis.drive.prior import ASYMMETRY_CHANGES, may_be_tilted
from gyrocal.diagnosis.drive.reckoning import Figures
from gyrocal.diagnosis.drive.search import YawAnswer
from gyrocal.diagnosis.drive.series import DriveSeries
from gyrocal.diagnosis.drive.sides import ASYMMETRY, ratio_of_turns, uneven_gyro
from gyrocal.diagnosis.drive.truth import TruthAnswer
from gyrocal.errors import ProfileError
from gyrocal.fusion.robot import SlipFigures
from gyrocal.navigation.levels import BIAS_SHARES
from gyrocal.physics.drive import ROBOT_TILT, START_STOP_SLIP
from gyrocal.physics.slip import SLIP_LAWS
from gyrocal.records.robot import Robot
from gyrocal.units import DEG_PER_RT_H_TO_DPS_PER_RT_HZ, DEG_TO_RAD

#: What a bias changes by at the next switch-on: a share of it, and standard deviations of the 1/f noise. The drive model
#: has the latter as states of its own; only the paper's filter must be told.
_CHANGES, _FLICKERS = 0.06, 1.5
#: What the track changes by from one drive to the next, relative.
_TRACK_CHANGES = 2e-3
#: What no key of a robot file holds.
_NO_KEYS = {ROBOT_TILT.id, START_STOP_SLIP.id}
#: Coordinates over which it is the robot's turns that differ, and those over which its way does.
_OF_TURNS, _OF_THE_WAY = ("place",), ("speed", "heading", "acceleration")


def figures_of(
    series: DriveSeries, yaw: YawAnswer, parts: Mapping[str, OfTruth], truth: TruthAnswer | None
) -> Figures:
    """What the log says should be taken out of it: the bias, and all that is named."""
    told = _told(yaw, truth, parts, tuple(yaw.named))

    def value(name: str) -> float:
        return told[name][0] if name in told else 0.0

    half = 0.5 * value("asymmetry")
    moving = _moving(told)
    c = yaw.estimate("track")[0] if "track" in yaw.chosen else 0.0
    return Figures(
        bias_dps=joint_estimate(yaw, truth, "bias")[0],
        temp_c=reference_temp_c(series),
        bias_motion_dps=value("step"),
        bias_moving_dps=value(moving),
        bias_moving_s=MOVING.get(moving, 0.0),
        bias_before_dps=joint_estimate(yaw, truth, "jump")[0] if "jump" in yaw.chosen else 0.0,
        bias_before_s=yaw.jump_s,
        bias_settling_dps=joint_estimate(yaw, truth, yaw.settling)[0] if yaw.settling else 0.0,
        bias_settling_s=SETTLING.get(yaw.settling, np.inf),
        bias_slope_dps_per_c=value("slope"),
        gyro_scale=value("gyro_scale"),
        gyro_asymmetry=value(ASYMMETRY),
        left_scale=(1 + value("wheel_scale")) * (1 - half) - 1,
        right_scale=(1 + value("wheel_scale")) * (1 + half) - 1,
        delay_s=value("delay"),
        track=(1 + c) * (1 + value("gyro_scale")) / (1 + value("wheel_scale")) - 1,
        slip=_slip(yaw, tuple(yaw.named)) or SlipFigures(),
    )


def _told(
    yaw: YawAnswer, truth: TruthAnswer | None, parts: Mapping[str, OfTruth], named: Sequence[str]
) -> dict[str, tuple[float, float]]:
    """Value and standard deviation of laws that the heading difference names, and of what the truth shows.

    Turns to one side tell a scale of all turns together with what the sides differ by, and neither without the other.
    """
    of_encoders = {n: told_estimate(yaw, truth, n) for n in named}
    of_path = {n: (s.value, s.std) for n, s in parts.items()}
    uneven = uneven_gyro(truth)
    if truth is not None and uneven is not None:
        of_path |= {
            "gyro_scale": (truth.values["gyro_scale"], truth.stds["gyro_scale"]),
            ASYMMETRY: uneven,
        }
    return of_encoders | of_path


def _foretold_motion(yaw: YawAnswer, name: str, told: tuple[float, float]) -> tuple[float, float]:
    """A law of the motion for the next drive, with what a bias that settles beside it does in the mean.

    A gyro that warms up on one drive does so on the next, which no robot file holds: without that, what cancels it would be
    taken out alone.
    """
    if not yaw.settling:
        return told
    alone = yaw.less([yaw.settling, "jump"])
    away = alone.estimate(name)[0] - yaw.estimate(name)[0]
    return told[0] + away, float(np.hypot(told[1], away))


def _moving(told: Iterable[str]) -> str:
    """The law of the bias that follows the motion; empty where there is none."""
    return next((n for n in told if n in MOVING), "")


def believed_bias(yaw: YawAnswer, truth: TruthAnswer | None) -> float:
    """The constant bias at the end of a drive as far as it is to be believed, deg/s.

    The robot file's own figure may be off by all that it grants, or by a small share of that: some drivers take the bias
    off, and some files grant what any gyro may have. The drive chooses among such shares, any as likely beforehand, by its
    likelihood: an estimate that is off from the file's by no more than its own error would make half of all drives worse.
    """
    bias, std = joint_estimate(yaw, truth, "bias")
    if "bias" not in yaw.known:
        # Nothing is known beforehand of one that jumps.
        return bias
    given, granted = yaw.known["bias"]
    # What the drive says by itself, without what was granted.
    own = std**-2 - granted**-2
    if own <= 0.0:
        return given
    away = (bias - given) / (own * std**2)
    least = BIAS_SHARES[-1] * min(granted, own**-0.5)
    off = np.geomspace(granted, least, 2 * len(BIAS_SHARES)) ** 2
    spread = off + 1.0 / own
    likely = np.exp(0.5 * away**2 * (1.0 / spread[0] - 1.0 / spread)) / np.sqrt(spread)
    return float(given + away * (likely @ (off / spread)) / likely.sum())


def foretold_bias(yaw: YawAnswer, truth: TruthAnswer | None) -> float:
    """The bias to expect on the next drive, deg/s.

    Of one that changes within the drive nobody knows which is next: it is between, as far as the robot file's own allows. One
    that settles after the start does so on the next drive, too, and counts by its mean.
    """
    bias, (middle, half) = believed_bias(yaw, truth) + _settles(yaw, truth)[0], _unsteady(yaw, truth)
    if half == 0.0:
        return bias
    robot = yaw.model.frame.series.robot
    given, std = robot.parameters.gyro.bias_dps, robot.initial_std["gyro_bias_dps"]
    return given + std**2 / (std**2 + half**2) * (bias + middle - given)


def _unsteady(yaw: YawAnswer, truth: TruthAnswer | None) -> tuple[float, float]:
    """From the bias to the middle of those that a drive has, and how far they lie from that, deg/s."""
    if "jump" in yaw.chosen:
        half = 0.5 * joint_estimate(yaw, truth, "jump")[0]
        return half, abs(half)
    return 0.0, 0.0 if truth is None else truth.bias_moves_dps


def _settles(yaw: YawAnswer, truth: TruthAnswer | None) -> tuple[float, float]:
    """Mean over the drive of a bias that settles after its start, and how far it lies from that (rms), deg/s."""
    if not yaw.settling:
        return 0.0, 0.0
    faded = settling(yaw.model.frame.series, SETTLING[yaw.settling])
    value, _ = joint_estimate(yaw, truth, yaw.settling)
    return value * float(np.mean(faded)), abs(value) * float(np.std(faded))


def improved_robot(
    series: DriveSeries,
    yaw: YawAnswer,
    truth: TruthAnswer | None,
    parts: Mapping[str, OfTruth],
    figures: Figures,
) -> Robot | None:
    """The robot file with everything that earned it; None where the drive tells nothing that a robot could use.

    The bias is written wherever no rest takes it off, as far as it foretells that of the next drive; a law from its
    gain on, a scale from where the truth is sure.
    Left-out parts of the drive are no judge here: a step of the bias lives in a single rest. But a law that changes within
    the drive has the name of something else, and the next drive has none of it; nor, where no truth tells, of a step that
    may be all that the log shows of a bias that settled.
    """
    blind = truth is None or truth.mirrored
    lasting = [n for n in yaw.named if n not in yaw.uneven and not (blind and yaw.settles(n))]
    keys: dict[str, Any] = {}
    if not series.rested:
        keys |= _bias_keys(yaw, truth, figures.temp_c)
    told = _told(yaw, truth, parts, lasting)
    told |= {n: _foretold_motion(yaw, n, told[n]) for n in of_motion(lasting)}
    told |= {n: or_nothing(*told[n], 1.0 / (1.0 + yaw.time_odds)) for n in told if n == "slope"}
    for law in (n for n in told if n in KINDS and KINDS[n].figure):
        keys[f"gyro.{KINDS[law].figure}"], keys[f"gyro.{KINDS[law].figure}_std"] = told[law]
    if moving := _moving(told):
        keys["gyro.bias_moving_s"] = KINDS[moving].lag_s
    if "slope" in told:
        keys["gyro.temp_c"] = figures.temp_c
    if yaw.window_s > 0:
        keys["encoders.window_s"] = yaw.window_s
    # What a tilt lacks of turns is no share of them, and the next drive need not have it.
    if "gyro_scale" in told and not (yaw.odd and may_be_tilted(series, told["gyro_scale"][0])):
        keys |= _scale_keys(truth, told)
    if slip := _slip(yaw, lasting):
        keys |= {f"slip.{key}": getattr(slip, key) for key in ("law", "amplitude", "amplitude_std", "shape")}
    # A slope stays where it is.
    wheels = {"asymmetry"} if ROBOT_TILT.id in parts else {"track", "asymmetry"}
    earned = bool(keys) or bool(set(parts) - _NO_KEYS) or not wheels.isdisjoint(lasting)
    if not earned:
        return None
    if series.differential:
        # Turns that slip without a law of it are wider in the mean.
        untold = [n for n in yaw.chosen if is_slip(n) and slip is None]
        keys |= _geometry_keys(series, yaw.less(untold), truth, parts, told)
    elif "wheel_scale" in parts:
        for side in ("left", "right"):
            keys[f"encoders.{side}_scale"] = parts["wheel_scale"].value
            keys[f"encoders.{side}_scale_std"] = parts["wheel_scale"].std
    if truth is not None and not truth.mirrored and "gyro_scale" not in told:
        # Not sure enough to be taken out, and yet better known than before.
        left = float(np.linalg.norm([truth.values["gyro_scale"], truth.stds["gyro_scale"], truth.one_size]))
        keys["gyro.scale_std"] = min(left, series.robot.initial_std["gyro_scale"])
    keys |= _noise_keys(yaw)
    return asked_anew(series.robot).with_figures(beyond_given(series, keys))


def _scale_keys(truth: TruthAnswer | None, told: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Scales of the gyro, which the filter must not trust beyond what turns to one side may be off by."""
    (scale, std), by_side = told["gyro_scale"], 0.0 if truth is None else truth.one_size
    keys = {}
    if ASYMMETRY in told:
        keys["gyro.asymmetry"], keys["gyro.asymmetry_std"] = told[ASYMMETRY]
        by_side = 0.5 * told[ASYMMETRY][1]
    return keys | {"gyro.scale": scale, "gyro.scale_std": float(np.hypot(std, by_side))}


def _bias_keys(yaw: YawAnswer, truth: TruthAnswer | None, temp_c: float) -> dict[str, float]:
    bias, std = joint_estimate(yaw, truth, "bias")
    apart = (_CHANGES * bias, _unsteady(yaw, truth)[1], _settles(yaw, truth)[1])
    changes = float(np.linalg.norm(apart))
    keys = {
        "gyro.bias_dps": foretold_bias(yaw, truth),
        "gyro.bias_dps_std": std,
        "gyro.repeatability_dps": changes,
        "initial_std.gyro_bias_dps": float(
            np.linalg.norm([std, changes, _FLICKERS * yaw.model.noise.flicker_dps])
        ),
    }
    return keys | ({"gyro.temp_c": temp_c} if np.isfinite(temp_c) else {})


def _slip(yaw: YawAnswer, named: Sequence[str]) -> SlipFigures | None:
    """The law of slip as a robot file has it; none where it would turn the robot backwards, which no robot file holds.

    A fit adds it to the track, and its curvature is by the track of the given file; a robot widens its own track by it.
    """
    name = next((n for n in named if n.startswith("slip_")), None)
    if name is None:
        return None
    law, shape = SLIP_LAWS[int(yaw.laws[name].shape["law"])], yaw.laws[name].shape["shape"]
    wider = 1.0 + yaw.estimate("track")[0]
    times = wider**-2.0 if law == "curvature" else 1.0 / wider
    amplitude, std = (times * x for x in yaw.estimate(name))
    try:
        return SlipFigures(law, amplitude, std, shape * wider if law == "curvature_saturating" else shape)
    except ProfileError:
        return None


def _untold_wheels(series: DriveSeries, truth: TruthAnswer | None) -> OfTruth:
    """What both wheels may be off by alike where the truth is not sure enough to take it out, or there is none."""
    granted = series.robot.initial_std
    std = 0.5 * float(np.hypot(granted["left_scale"], granted["right_scale"]))
    if truth is not None and not truth.mirrored:
        std = min(std, float(np.hypot(truth.values["wheel_scale"], truth.stds["wheel_scale"])))
    return OfTruth(0.0, std)


def _geometry_keys(
    series: DriveSeries,
    yaw: YawAnswer,
    truth: TruthAnswer | None,
    parts: Mapping[str, OfTruth],
    told: Mapping[str, tuple[float, float]],
) -> dict[str, float]:
    """Track and wheels as estimated, with what they are known to: the filter begins where this drive ended."""
    bias = joint_estimate(yaw, truth, "bias")[0] if series.rested else believed_bias(yaw, truth)
    asymmetry, std = _beside_bias(yaw, "asymmetry", bias)
    wheels = parts["wheel_scale"] if "wheel_scale" in parts else _untold_wheels(series, truth)
    uneven = ASYMMETRY in told
    track, track_std = ratio_of_turns(yaw, truth) if uneven else _beside_bias(yaw, "track", bias)
    track_std = float(np.hypot(track_std, _unheld(yaw, _OF_TURNS, "track")))
    # What the scales of the truth, or a slope, make of the ratio of the headings is no track.
    gyro, _ = told.get("gyro_scale", (0.0, 0.0))
    track = (1 + track) * (1 + gyro) / (1 + wheels.value) - 1
    if "track" not in parts and not uneven and not {*SCALES, ROBOT_TILT.id}.isdisjoint(parts):
        track = 0.0
    separation = series.robot.wheel_separation_m * (1 + track)
    changes = float(np.hypot(ASYMMETRY_CHANGES, _unheld(yaw, _OF_THE_WAY, "asymmetry")))
    one = float(np.hypot(std, changes)) / np.sqrt(2.0)
    keys = {
        "wheel_separation_m": separation,
        "initial_std.wheel_separation_m": separation * float(np.hypot(track_std, _TRACK_CHANGES)),
    }
    for side, sign in (("left", -1.0), ("right", 1.0)):
        keys[f"encoders.{side}_scale"] = (1 + wheels.value) * (1 + sign * 0.5 * asymmetry) - 1
        keys[f"encoders.{side}_scale_std"] = float(np.hypot(wheels.std, 0.5 * std))
        keys[f"initial_std.{side}_scale"] = float(one)
    return keys


def _unheld(yaw: YawAnswer, coordinates: Collection[str], law: str) -> float:
    """How far track or asymmetry differ within the drive (rms, relative) over coordinates in which something lives.

    No robot file holds that, and the next drive has other places, headings and speeds.
    """
    blocks = strangers(yaw.model.frame)
    cells = [
        n
        for n in yaw.gram.names
        if ":" in n and n.split(":")[0] in coordinates and n.split(":")[0] in yaw.odd
    ]
    if not cells:
        return 0.0
    values, covariance = yaw.beyond(cells)
    columns = np.column_stack([blocks[c][:, int(k)] for c, k in (n.split(":") for n in cells)])
    moved = columns @ values
    noise = np.einsum("ij,jk,ik", columns, covariance, columns)
    square = max(float(moved @ moved) - float(noise), 0.0)
    return float(np.sqrt(square) / np.linalg.norm(yaw.laws[law].column))


def _beside_bias(yaw: YawAnswer, name: str, bias_dps: float) -> tuple[float, float]:
    """A figure of the wheels beside the bias that is written: what truth or prudence took off the one is in the other.

    Without a rest a drive tells little more than a sum of both.
    """
    value, std = yaw.estimate(name)
    at = [yaw.chosen.index(n) for n in ("bias", name)]
    (variance, shared), _ = yaw.covariance[np.ix_(at, at)]
    return value + float(shared / variance) * (bias_dps - yaw.estimate("bias")[0]), std


def _noise_keys(yaw: YawAnswer) -> dict[str, float]:
    """Levels of the noise; a bias that jumped or settled within the drive walks as far on the next, where nobody knows when."""
    noise = yaw.model.noise
    rt_s = float(np.sqrt(yaw.model.frame.series.duration_s))
    walks = [noise.walk_dps_per_rt_s, *(yaw.estimate(n)[0] / rt_s for n in yaw.passing)]
    keys = {
        "noise.angle_random_walk_deg_per_rt_h": noise.arw_dps_per_rt_hz / DEG_PER_RT_H_TO_DPS_PER_RT_HZ,
        "noise.bias_walk_dps_per_rt_s": float(np.linalg.norm(walks)),
        "noise.flicker_dps": noise.flicker_dps,
        # The gyro's own: wheels that err are not to make it noisier on the next drive.
        "noise.flicker_dps_std": noise.flicker_dps * yaw.model.log_std["flicker_dps"],
    }
    if not yaw.model.frame.series.differential:
        return keys
    return keys | {
        "noise.wheel_slip_m_per_rt_m": noise.slip_m_per_rt_m,
        "noise.turn_slip_deg_per_rt_deg": noise.turn / float(np.sqrt(DEG_TO_RAD)),
        # The rounding of two wheels, each of a step over the square root of twelve.
        "noise.tick_m": noise.tick_m * float(np.sqrt(6.0)),
        "noise.jitter_s": noise.jitter_s,
        "noise.track_wander": noise.track_wander,
        "noise.track_wander_s": noise.track_wander_s,
        "noise.wheel_wander": noise.wheel_wander,
        "noise.wheel_wander_s": noise.wheel_wander_s,
    }
