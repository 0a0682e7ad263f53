"""What names are worth on parts of a drive that were not fitted: turn of the encoders against that of the gyro."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gyrocal.diagnosis.answer.staircase import LeftOut, improvement
from gyrocal.diagnosis.drive.search import YawAnswer
from gyrocal.diagnosis.drive.series import Bools, Floats, Ints
from gyrocal.diagnosis.drive.weighing import Gram, gram_of
from gyrocal.diagnosis.drive.yaw import LEFT_OUT
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Improvement
from gyrocal.units import RAD_TO_DEG

#: Length of what is left out, s, and every how many-th of them together: a longer one would hold a whole rest, and with
#: it all that a log says of a step of the bias.
_BLOCK_S, _FOLDS = 5.0, 4
_SCHEME = Remark(Said.LEFT_OUT_BLOCKS, {"folds": _FOLDS, "block_s": _BLOCK_S})
#: Errors are means over about this time, s: of shorter ones ticks are the most.
_MEAN_S = 1.0


def improvements(yaw: YawAnswer, effects: Sequence[str]) -> tuple[Improvement | None, dict[str, Improvement]]:
    """What all names together are worth beside the constant laws, and each beside the others.

    Names that the heading difference does not carry, such as scales that only the truth shows, are left out.
    """
    laws = {
        effect: [n for n in yaw.chosen if n in _of(yaw, effect)]
        for effect in effects
        if any(n in yaw.named for n in _of(yaw, effect))
    }
    if not laws:
        return None, {}
    grams = _grams(yaw)
    rng = np.random.default_rng(7)
    whole, sure = _left_out(yaw, grams, ())

    def gained(names: Sequence[str]) -> Improvement:
        return replace(improvement(_left_out(yaw, grams, names)[0], whole, sure, rng), scheme=_SCHEME)

    return gained([n for names in laws.values() for n in names]), {e: gained(n) for e, n in laws.items()}


def _of(yaw: YawAnswer, effect: str) -> list[str]:
    return [n for n, law in yaw.laws.items() if law.effect == effect and n not in ("bias", "jump")]


def _fold(yaw: YawAnswer) -> Ints:
    at = yaw.model.frame.nodes.t_s
    return np.asarray(np.floor((at - at[0]) / _BLOCK_S).astype(np.int64) % _FOLDS)


def _grams(yaw: YawAnswer) -> list[Gram]:
    """Inner products of the laws, for each fold without its intervals."""
    columns = {n: yaw.laws[n].column for n in yaw.chosen}
    fold, model, known = _fold(yaw), yaw.model, yaw.known
    return [
        gram_of(replace(model, left_out=np.where(fold == k, LEFT_OUT, model.left_out)), columns).knowing(
            known
        )
        for k in range(_FOLDS)
    ]


def _left_out(yaw: YawAnswer, grams: Sequence[Gram], less: Sequence[str]) -> tuple[LeftOut, Bools]:
    """Errors of each second by laws that were fitted without it, deg/s, and which seconds count."""
    fold, error = _fold(yaw), yaw.model.y.copy()
    kept = [n for n in yaw.chosen if n not in less]
    # A delay that was taken out before the fit stands in the difference again where it is not to be known.
    again_s = yaw.ahead_s if "delay" in less else 0.0
    if again_s:
        error += again_s * yaw.laws["delay"].column
    for k, gram in enumerate(grams):
        whole = gram
        if again_s:
            delayed = gram.matrix[:, gram.names.index("delay")]
            whole = replace(gram, right=gram.right + again_s * delayed)
        for name, value in zip(kept, whole.solve(kept)[0], strict=True):
            error[fold == k] -= value * yaw.laws[name].column[fold == k]
    return _by_second(yaw, error)


def _by_second(yaw: YawAnswer, error: Floats) -> tuple[LeftOut, Bools]:
    model, nodes = yaw.model, yaw.model.frame.nodes
    number, second = np.unique(np.floor((nodes.t_s - nodes.t_s[0]) / _MEAN_S), return_inverse=True)

    def total(values: Floats) -> Floats:
        return np.asarray(np.bincount(second, values))

    over_s = total(nodes.dt_s)
    squares = (RAD_TO_DEG * total(error) / over_s) ** 2
    # Within a second the errors of ticks cancel, but for those at its ends.
    ends = 2.0 * (model.noise.tick_m / model.frame.series.robot.wheel_separation_m) ** 2
    variance = RAD_TO_DEG**2 * (total(model.white) + ends) / over_s**2
    block = (number * _MEAN_S / _BLOCK_S).astype(np.int64)
    return LeftOut(squares, variance, block), total(model.left_out) == 0.0
