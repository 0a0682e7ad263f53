"""Where a vehicle stands: by its ticks, by its speed, and by the gyro where a speed never reads zero, for that has noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.errors import DataError
from gyrocal.fusion.static_bias import static_bias
from gyrocal.inference.runs import runs_of

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

#: What counts as motion of a wheel without ticks, m/s.
STILL_MPS = 1e-3
#: Below this share of the usual highest speed, as means over `_MEAN_S`, a vehicle creeps or stands, and stands so long, s, where it
#: does.
_SLOW, _LEAST_S = 0.01, 5.0
#: Share of the rows that are slower than the usual highest speed.
_USUAL = 0.95
#: A gyro that stands has means over so long, s, that are no further from their mean than this many times what its samples' own
#: noise makes of them: a vehicle that creeps turns, by little, but never evenly.
_MEAN_S, _STANDS = 1.0, 4.0
#: And their own noise is at most this many times that of the quietest such stretch: one that rolls shakes its gyro.
_SHAKEN = 3.0


def moving_rows(
    t_s: Floats,
    dt_s: Floats,
    wheels: tuple[Floats, Floats],
    ticks: tuple[float, float],
    gyro_dps: Floats,
    *,
    noisy_rests: bool = True,
) -> tuple[Bools, list[Remark]]:
    """Rows in which a wheel moves, but for rests in which a speed reads its own noise, which are said.

    Parameters
    ----------
    t_s, dt_s, gyro_dps : ndarray, shape (n,)
    wheels : pair of ndarray, shape (n,)
        Distances since the row before, m.
    ticks : pair of float
        Size of a tick of each; 0 where it has none.
    noisy_rests : bool
        Whether there are such rests: of an answer that they contradict there are none.
    """
    moving = np.zeros(dt_s.size, dtype=bool)
    for step, tick in zip(wheels, ticks, strict=True):
        moving |= np.abs(step) > (0.5 * tick if tick else STILL_MPS * np.maximum(dt_s, 1e-3))
    if any(ticks) or not noisy_rests:
        return moving, []
    step_m = np.maximum(*np.abs(wheels))
    stands = _standing(t_s, step_m, gyro_dps, moving)
    if not stands.any():
        return moving, []
    # The first row has no time before it.
    lasting = stands & (dt_s > 0.0)
    most_mps = float(np.max(step_m[lasting] / dt_s[lasting]))
    facts = {"total_s": float(np.sum(dt_s[stands])), "most_mps": most_mps}
    return moving & ~stands, [Remark(Said.STANDS, facts)]


def still_rows(t_s: Floats, moving: Bools, margin_s: float) -> Bools:
    """Rows without motion from a margin before to a margin after."""
    # A row exactly at the margin is within it, however times are rounded.
    margin_s *= 1.0 + 1e-9
    count = np.concatenate([[0], np.cumsum(moving)])
    begin = np.searchsorted(t_s, t_s - margin_s, side="left")
    end = np.searchsorted(t_s, t_s + margin_s, side="right")
    return np.asarray(count[end] == count[begin])


def refused_rest(t_s: Floats, left_m: Floats, right_m: Floats, gyro_dps: Floats, static_s: float) -> str:
    """Why `replay` refuses a log that lacks the rest at its start that a robot file promises; empty where it does not."""
    if static_s == 0.0:
        return ""
    try:
        static_bias(t_s, left_m, right_m, gyro_dps, static_s)
    except DataError as error:
        return str(error)
    return ""


def _standing(t_s: Floats, step_m: Floats, gyro_dps: Floats, moving: Bools) -> Bools:
    """Rows in which a vehicle stands though its speed is not zero; none where that is zero at its rests.

    Parameters
    ----------
    t_s, step_m, gyro_dps, moving : ndarray, shape (n,)
        Time of each row, distance since the row before, rate, and whether a wheel moves by its distance.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    found = np.zeros(t_s.size, dtype=bool)
    if any(t_s[run[-1]] - t_s[run[0]] >= _LEAST_S for run in runs_of(np.flatnonzero(~moving))):
        return found
    whole_m = np.cumsum(np.abs(step_m))
    ahead_m, behind_m = (np.interp(t_s + side * 0.5 * _MEAN_S, t_s, whole_m) for side in (1.0, -1.0))
    speed_mps = (ahead_m - behind_m) / _MEAN_S
    slow = np.flatnonzero(speed_mps < _SLOW * float(np.quantile(speed_mps, _USUAL)))
    stretches = [run for run in runs_of(slow) if t_s[run[-1]] - t_s[run[0]] >= _LEAST_S]
    quietest = min((_white(gyro_dps[run]) for run in stretches), default=0.0)
    for run in stretches:
        if _white(gyro_dps[run]) <= _SHAKEN * quietest and _is_still(t_s[run], gyro_dps[run]):
            found[run] = True
    return found


def _white(gyro_dps: Floats) -> float:
    """Standard deviation of the noise of single samples, by their neighbours."""
    return float(np.sqrt(0.5 * np.mean(np.diff(gyro_dps) ** 2)))


def _is_still(t_s: Floats, gyro_dps: Floats) -> bool:
    """Whether means over a second scatter as the noise of single samples makes them, which neighbours tell."""
    second = np.floor((t_s - t_s[0]) / _MEAN_S).astype(np.int64)
    counts = np.bincount(second)
    full = counts >= 0.5 * np.median(counts)
    means = (np.bincount(second, gyro_dps) / np.maximum(counts, 1))[full]
    expected_dps = _white(gyro_dps) / np.sqrt(counts[full])
    return bool(np.all(np.abs(means - means.mean()) <= _STANDS * expected_dps))
