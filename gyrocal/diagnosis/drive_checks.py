"""What a drive log shows beside the heading difference: units, ticks, time stamps, wheels out of true."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from gyrocal.diagnosis import robust
from gyrocal.diagnosis.drive import YawFit
from gyrocal.diagnosis.drive_series import GAP_STEPS, Bins, DriveSeries, bins_of
from gyrocal.diagnosis.result import Alternative, Estimate
from gyrocal.records.drive import DriveBlock
from gyrocal.units import RAD_TO_DEG

Floats = NDArray[np.float64]

_NONE = (float("nan"), float("nan"))
#: A factor this near to a wrong unit (on a log scale: a factor of 3) is one; nothing physical comes near.
_UNIT_FACTOR = 3.0
_WINDOW_S = 5.0
#: Fine bins for what goes round with a wheel, s, and the radii that are tried, m.
_FINE_S = 0.1
_RADII_M = (0.02, 0.6)
_PEAKS = 6
_BLOCK_S = 4.0
#: Median absolute deviations beyond which a fine bin is cut down.
_FAR = 12.0
_FINE_ROWS = 60_000
#: Evidence by which a wheel has to beat a swing of fixed frequency, nats (20 to 1).
_CLEAR_NATS = 3.0


#: An error of a scale or of a wheel that is smaller, relative, is of no use to anyone, however well it is known.
NEGLIGIBLE = 1e-3
#: Share of the noise's variance from which on ticks and time stamps matter.
_MATTERS = 0.05


@dataclass(frozen=True)
class Found:
    """An effect that a check of its own has found."""

    effect: str
    parameters: Mapping[str, Estimate]
    p_value: float
    sentence: str
    alternatives: tuple[Alternative, ...] = ()


def wrong_unit(series: DriveSeries) -> tuple[float, Found | None]:
    """Factor that brings the gyro to deg/s counter-clockwise, and what was wrong; 1 and None where nothing is.

    The ratio of gyro to encoder yaw over windows, by the total least-squares line, which no side's noise bends.
    """
    bins = bins_of(series, 0.0, _WINDOW_S)
    e, g = (v - np.median(v) for v in (bins.encoder_deg, bins.gyro_deg))
    see, sgg, seg = float(e @ e), float(g @ g), float(e @ g)
    if min(see, sgg) <= 0 or seg**2 < 0.25 * see * sgg:
        return 1.0, None
    ratio = float(np.sign(seg) * np.sqrt(sgg / see))
    for factor, what in (
        (RAD_TO_DEG, "in rad/s"),
        (1.0 / RAD_TO_DEG, "converted to degrees twice"),
        (1.0, ""),
    ):
        if not 1 / _UNIT_FACTOR < abs(ratio) * factor < _UNIT_FACTOR:
            continue
        turned = "with the sign inverted, or left and right wheel are swapped" if ratio < 0 else ""
        if not what and not turned:
            return 1.0, None
        said = " and ".join(text for text in (what, turned) if text)
        amplitude = float(np.sign(ratio)) / factor
        spread = abs(ratio) * float(np.sqrt(max(1.0 - seg**2 / (see * sgg), 0.0) / max(e.size - 2, 1)))
        found = Found(
            "unit_or_sign",
            {"amplitude": Estimate(ratio, spread, "1", (ratio - 1.96 * spread, ratio + 1.96 * spread))},
            1e-16,
            f"The gyro column is {said} (its turns over those of the encoders).",
        )
        return 1.0 / amplitude, found
    return 1.0, None


def time_stamps(log: DriveBlock, usual_dt_s: float) -> list[Found]:
    """Dropped samples (gaps, rows of equal time) and unsteady time stamps, as they stand in the log."""
    found = []
    steps = np.diff(log.t_s)
    gaps = steps > GAP_STEPS * usual_dt_s
    lost = int(np.sum(np.round(steps[steps > 1.8 * usual_dt_s] / usual_dt_s) - 1)) if usual_dt_s > 0 else 0
    if gaps.any() or lost > 0.001 * steps.size:
        share = 100.0 * lost / (lost + steps.size + 1)
        text = f"About {lost} rows are missing ({share:.2g} % of the log, {int(gaps.sum())} long gaps, the longest {steps.max():.3g} s)."
        found.append(
            Found("dropped_samples", {"amplitude": Estimate(share, float("nan"), "%", _NONE)}, 1e-16, text)
        )
    regular = steps[(steps > 0.2 * usual_dt_s) & (steps < 1.8 * usual_dt_s)]
    jitter_ms = float(1e3 * np.std(regular) / np.sqrt(2.0)) if regular.size else 0.0
    if jitter_ms > 0.05e3 * usual_dt_s:
        text = f"Time stamps scatter by {jitter_ms:.2g} ms about an even clock of {1e3 * usual_dt_s:.3g} ms."
        std = jitter_ms / float(np.sqrt(2.0 * regular.size))
        estimate = Estimate(jitter_ms, std, "ms", (jitter_ms - 1.96 * std, jitter_ms + 1.96 * std))
        found.append(Found("timestamp_jitter", {"amplitude": estimate}, 1e-16, text))
    return found


def ticks(log: DriveBlock) -> Found | None:
    """Encoders in whole ticks: all distances are multiples of one, a few of them only."""
    moved = np.abs(np.concatenate([log.left_m, log.right_m]))
    moved = moved[np.isfinite(moved) & (moved > 0)]
    values, counts = np.unique(np.round(moved, 9), return_counts=True)
    if values.size < 2 or values.size > 0.02 * moved.size:
        return None
    # The distance of a tick is the smallest step between values that occur often.
    common = values[counts >= max(3, 1e-3 * moved.size)]
    if common.size < 2:
        return None
    tick_m = float(np.min(np.diff(np.concatenate([[0.0], common]))))
    off = np.abs(values / tick_m - np.round(values / tick_m))
    if tick_m < 1e-6 or np.max(off[values < 200 * tick_m], initial=0.0) > 0.02:
        return None
    text = f"The encoders count whole ticks of {1e3 * tick_m:.4g} mm ({values.size} distinct distances in {moved.size} rows)."
    return Found(
        "encoder_quantisation", {"amplitude": Estimate(1e3 * tick_m, float("nan"), "mm", _NONE)}, 1e-16, text
    )


def of_the_log(
    log: DriveBlock, usual_dt_s: float, fit: YawFit, separation_m: float
) -> tuple[list[Found], tuple[str, ...]]:
    """Findings about the logging itself; ticks and time stamps that hardly add to the noise are remarks only.

    Parameters
    ----------
    fit : YawFit
        Its noise is what ticks and time stamps are measured by.
    """
    variance = float(np.median(fit.noise.std_deg**2))
    turn = float(np.mean(fit.bins.turn_rate_dps**2))
    found, remarks = [], []
    size = ticks(log)
    for f in (*([] if size is None else [size]), *time_stamps(log, usual_dt_s)):
        amplitude = 1e-3 * f.parameters["amplitude"].value
        # A bin is the difference of two readings, each off by the error; both wheels have ticks.
        part = {
            "encoder_quantisation": 4.0 * amplitude**2 / 12.0 * (RAD_TO_DEG / separation_m) ** 2,
            "timestamp_jitter": 2.0 * amplitude**2 * turn,
        }.get(f.effect, np.inf)
        if part > _MATTERS * variance:
            found.append(f)
        else:
            share = 100.0 * part / variance
            remarks.append(f"{f.sentence.rstrip('.')}: {share:.1g} % of the noise of the heading difference")
    return found, tuple(remarks)


def eccentric_wheel(series: DriveSeries, delay_s: float, ratio: float, level: float) -> Found | None:
    """A wheel out of true: a line at one turn of a wheel, of whichever radius, on either side.

    Parameters
    ----------
    ratio : float
        Encoder yaw over gyro yaw that the named effects leave, so that turns do not leak into the line.

    Notes
    -----
    The spectrum over the travelled distance proposes, the robust score test decides; its p-value is multiplied by
    the number of independent lines that were looked at.
    """
    width_s = max(_FINE_S, series.usual_dt_s, series.duration_s / _FINE_ROWS)
    bins = bins_of(series, delay_s, width_s)
    y = bins.encoder_deg - ratio * bins.gyro_deg
    moves = np.abs(bins.speed_mps) > 0.05
    moving = np.abs(bins.speed_mps[moves])
    if moving.size < 100:
        return None
    # Isolated slips are no swing: they are cut down to the size of the rest.
    middle = float(np.median(y[moves]))
    y = middle + np.clip(
        y - middle, *(_FAR * float(np.median(np.abs(y[moves] - middle))) * np.array([-1, 1]))
    )
    # A turn of the wheel takes at least four bins, else it is not seen.
    smallest_m = max(_RADII_M[0], 4.0 * width_s * float(np.median(moving)) / (2 * np.pi))
    rows = round(_BLOCK_S / width_s)
    regression = robust.regress(y, bins.distance_m[:, None], robust.autoregression(y, 20), rows)
    lines = {
        side: _spectral_lines(series, bins.t_s[regression.phi.size :], regression.residual, side, smallest_m)
        for side in (-1.0, 1.0)
    }
    trials = sum(count for _, count in lines.values())
    scale = RAD_TO_DEG / series.robot.wheel_separation_m
    cases = [(side, radius) for side, (radii, _) in lines.items() for radius in radii]
    columns = [scale * _wheel_line(series, bins.t_s, width_s, side, radius) for side, radius in cases]
    tests = [robust.line_test(regression, c) for c in columns]
    best = int(np.argmax([gain for gain, _ in tests]))
    gain, p_value = tests[best][0], min(1.0, tests[best][1] * trials)
    if p_value > level:
        return None
    # At a steady speed anything that swings at a fixed frequency looks like a wheel: it must lose clearly.
    hertz = float(np.median(moving)) / (2 * np.pi * cases[best][1]) * np.linspace(0.8, 1.2, 401)
    if max(robust.line_test(regression, _swing(bins.t_s, width_s, f))[0] for f in hertz) > gain - _CLEAR_NATS:
        return None
    found = _wheel_found(series, bins, y, *cases[best], p_value)
    return found if found.parameters["amplitude"].value > 100.0 * NEGLIGIBLE else None


def _wheel_found(
    series: DriveSeries, bins: Bins, y: Floats, side: float, radius: float, p_value: float
) -> Found:
    """Size and radius of a wheel out of true, from the heading difference `y`, deg a bin."""
    scale = RAD_TO_DEG / series.robot.wheel_separation_m
    radius, column = _tuned(series, bins, y / scale, side, radius)
    # The memory of the noise without the line: with it, whitening would take a part of the line away.
    plain = y - scale * column @ np.linalg.lstsq(scale * column, y, rcond=None)[0]
    rows = round(_BLOCK_S / bins.width_s)
    values, covariance, dof = robust.fit(y, scale * column, robust.autoregression(plain), rows)
    size = float(np.hypot(*values))
    gradient = values / size
    std = float(np.sqrt(gradient @ covariance @ gradient))
    t95 = float(stats.t.ppf(0.975, np.min(dof)))
    step = radius**2 * np.pi / float(np.ptp(series.right_m if side > 0 else series.left_m))
    low, high = 100 * (size - t95 * std), 100 * (size + t95 * std)
    return Found(
        "wheel_eccentricity",
        {
            "amplitude": Estimate(100 * size, 100 * std, "%", (low, high)),
            "wheel_radius_m": Estimate(radius, step / 2, "m", (radius - step, radius + step)),
            "side": Estimate(side, float("nan"), "1", _NONE),
        },
        p_value,
        f"The {'right' if side > 0 else 'left'} wheel's distance is modulated every {2 * np.pi * radius:.3g} m, "
        f"once a turn of a wheel of radius {radius:.3g} m.",
    )


def _tuned(
    series: DriveSeries, bins: Bins, y_m: Floats, side: float, radius_m: float
) -> tuple[float, Floats]:
    """The radius, between two lines of the spectrum, whose line fits best, and its columns."""
    reach = np.pi * radius_m**2 / (2.0 * float(np.ptp(series.right_m if side > 0 else series.left_m)))

    def left(radius: float) -> float:
        column = _wheel_line(series, bins.t_s, bins.width_s, side, radius)
        residual = y_m - column @ np.linalg.lstsq(column, y_m, rcond=None)[0]
        return float(residual @ residual)

    bounds = (radius_m - reach, radius_m + reach)
    found = optimize.minimize_scalar(left, bounds=bounds, method="bounded", options={"xatol": 1e-3 * reach})
    return float(found.x), _wheel_line(series, bins.t_s, bins.width_s, side, float(found.x))


def _spectral_lines(
    series: DriveSeries, t_s: Floats, residual: Floats, side: float, smallest_m: float
) -> tuple[Floats, int]:
    """Radii of the strongest lines of a residual over one side's distance, and how many lines were looked at."""
    wheel = series.right_m if side > 0 else series.left_m
    travelled = np.interp(t_s, series.t_s, wheel)
    length = float(np.ptp(travelled))
    step_m = min(0.5 * smallest_m, length / travelled.size)
    # Summed where the wheel stood, so that a robot may go back and forth; backwards a line turns its sign.
    forward = np.sign(np.gradient(travelled))
    place = np.floor((travelled - travelled.min()) / step_m).astype(np.int64)
    even = np.bincount(place, residual * forward)
    # Padded, so that a line between two frequencies is not lost.
    power = np.abs(np.fft.rfft(even, 4 * even.size)) ** 2
    per_m = np.fft.rfftfreq(4 * even.size, step_m)
    used = (per_m > 1 / (2 * np.pi * _RADII_M[1])) & (per_m < 1 / (2 * np.pi * smallest_m))
    peak = used & (power > np.roll(power, 1)) & (power > np.roll(power, -1))
    order = np.argsort(np.where(peak, power, 0.0))[::-1][:_PEAKS]
    return 1 / (2 * np.pi * per_m[order]), int(np.count_nonzero(used)) // 4 + 1


def _swing(t_s: Floats, width_s: float, frequency_hz: float) -> Floats:
    """Change of a swing of fixed frequency in each bin, cosine and sine."""
    begin, end = (2 * np.pi * frequency_hz * (t_s + half) for half in (-0.5 * width_s, 0.5 * width_s))
    return np.stack([np.sin(end) - np.sin(begin), np.cos(begin) - np.cos(end)], axis=1)


def _wheel_line(series: DriveSeries, t_s: Floats, width_s: float, side: float, radius_m: float) -> Floats:
    """Change of one side's distance in each bin by an eccentricity of one, cosine and sine; signed by side."""
    wheel = series.right_m if side > 0 else series.left_m
    begin = np.interp(t_s - 0.5 * width_s, series.t_s, wheel) / radius_m
    end = np.interp(t_s + 0.5 * width_s, series.t_s, wheel) / radius_m
    lines = [np.sin(end) - np.sin(begin), np.cos(begin) - np.cos(end)]
    return np.asarray(side * radius_m * np.stack(lines, axis=1))
