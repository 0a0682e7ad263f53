"""Encoder turns against gyro turns: how far, how late, and how well they agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.navigation.survey import (
    DELAY_WINDOW_S,
    MAX_DELAY_S,
    WINDOW_S,
    Survey,
    sliding,
)

Floats = NDArray[np.float64]

_DELAY_STEP_S = 0.05
_BLOCKS = 10


@dataclass(frozen=True)
class YawComparison:
    """Encoder turns against gyro turns: ``encoder(t + delay) = ratio * gyro(t) + offset``.

    Delay from windows of `DELAY_WINDOW_S`, ratio and offset from windows of `WINDOW_S` at that delay. `ratio` is
    the effective wheel separation over the assumed one, times the gyro's own scale: a heading log alone cannot
    tell the two apart. Each sigma by delete-a-block jackknife over ten blocks of the log.

    Attributes
    ----------
    correlation, correlation_undelayed : float
        Of windows of `DELAY_WINDOW_S`, at the delay and without it.
    effective_separation_m : float
        Wheel separation with which the encoders would turn as far as the gyro.
    """

    encoder_total_deg: float
    gyro_total_deg: float
    delay_s: float
    delay_sigma_s: float
    correlation: float
    correlation_undelayed: float
    ratio: float
    ratio_sigma: float
    offset_dps: float
    offset_sigma_dps: float
    effective_separation_m: float

    def to_json(self) -> dict[str, float]:
        """Plain data."""
        return dict(vars(self))

    def sentence(self, told_s: float = 0.0) -> str:
        """What the data prove, in words; `told_s` is the delay of the encoders that the robot file takes out."""
        text = (
            f"encoders turn {self.ratio:.3f} ± {self.ratio_sigma:.3f} times as far as the gyro "
            f"(effective wheel separation {self.effective_separation_m:.3f} m if the gyro's scale is right)"
        )
        sure_s = 3.0 * max(self.delay_sigma_s, _DELAY_STEP_S)
        if abs(self.delay_s) > sure_s:
            later = "later" if self.delay_s > 0 else "earlier"
            text += (
                f", and {abs(self.delay_s):.2f} ± {self.delay_sigma_s:.2f} s {later} (correlation of 1 s turns "
                f"{self.correlation_undelayed:.3f} as logged, {self.correlation:.3f} at that delay): "
            )
            if told_s == 0.0:
                text += "the robot file gives no gyro.delay_s, so nothing takes it out; `gyrocal diagnose` estimates it"
            elif abs(self.delay_s - told_s) <= sure_s:
                text += "the robot file's gyro.delay_s takes it out"
            else:
                text += f"the robot file's gyro.delay_s takes {told_s:.2f} s out, which is not this delay"
        return text


def compare_yaw(found: Survey, wheel_separation_m: float) -> YawComparison:
    """How encoder turns relate to gyro turns over a log."""
    turned = found.turns_deg(wheel_separation_m)
    delays = np.arange(-MAX_DELAY_S, MAX_DELAY_S + 0.5 * _DELAY_STEP_S, _DELAY_STEP_S)
    gyro = sliding(found, found.gyro_deg, DELAY_WINDOW_S)
    sums = np.array([_moments(gyro, sliding(found, turned, DELAY_WINDOW_S, d)) for d in delays])
    delay_s, correlation = _best(delays, sums.sum(axis=2))
    left_out = [_best(delays, sums.sum(axis=2) - sums[:, :, k])[0] for k in range(sums.shape[2])]
    pair = _moments(sliding(found, found.gyro_deg, WINDOW_S), sliding(found, turned, WINDOW_S, delay_s))
    ratio, offset = _line(pair.sum(axis=1))
    lines = np.array([_line(pair.sum(axis=1) - pair[:, k]) for k in range(pair.shape[1])])
    undelayed = float(_correlation(sums[delays.size // 2].sum(axis=1)))
    return YawComparison(
        float(turned.sum()),
        float(found.gyro_deg.sum()),
        delay_s,
        _jackknife(np.array(left_out)),
        correlation,
        undelayed,
        ratio,
        _jackknife(lines[:, 0]),
        offset / WINDOW_S,
        _jackknife(lines[:, 1]) / WINDOW_S,
        wheel_separation_m * ratio,
    )


def _moments(x: Floats, y: Floats) -> Floats:
    """Sums of 1, x, y, xx, yy, xy over consecutive blocks, shape (6, blocks)."""
    parts = zip(np.array_split(x, _BLOCKS), np.array_split(y, _BLOCKS), strict=True)
    return np.array([[p.size, p.sum(), q.sum(), p @ p, q @ q, p @ q] for p, q in parts]).T


def _centred(moments: Floats) -> tuple[Floats, Floats, Floats]:
    n, x, y, xx, yy, xy = moments
    return xx - x * x / n, yy - y * y / n, xy - x * y / n


def _correlation(moments: Floats) -> Floats:
    sxx, syy, sxy = _centred(moments)
    scale = np.sqrt(np.maximum(sxx * syy, 0.0))
    return np.asarray(np.divide(sxy, scale, out=np.zeros_like(scale), where=scale > 0))


def _line(moments: Floats) -> tuple[float, float]:
    sxx, _, sxy = _centred(moments)
    slope = float(sxy / sxx) if sxx > 0 else np.nan
    return slope, float((moments[2] - slope * moments[1]) / moments[0])


def _best(delays: Floats, moments: Floats) -> tuple[float, float]:
    """Delay of the highest correlation, by a parabola through the three highest, and that correlation."""
    correlation = _correlation(moments.T)
    k = int(np.argmax(correlation))
    if k in (0, delays.size - 1):
        return float(delays[k]), float(correlation[k])
    before, here, after = correlation[k - 1 : k + 2]
    bend = before - 2.0 * here + after
    shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return float(delays[k] + shift * _DELAY_STEP_S), float(here)


def _jackknife(left_out: Floats) -> float:
    n = left_out.size
    return float(np.sqrt((n - 1) / n * np.sum((left_out - left_out.mean()) ** 2)))
