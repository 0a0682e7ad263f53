"""Odometry and the nine-state indirect feedback Kalman filter (paper eqs. 6 to 13): the compiled loop.

Conventions: x forward, y left, counter-clockwise (REP 103): the paper's Y is x here, its X is y. Radians inside.
An *error* is estimate minus truth, as in eqs. 7 and 11: measured U_R = (1 + S_R) true U_R, assumed
D = true D + dD, assumed B = true B + dB.

Order of the states inside: x, y, psi, phi, dB_rb, dB_s, S_R, S_L, dD. Psi and phi stand before the constants that
drive them, so the transition matrix F is unit upper triangular. The covariance is carried as P = U diag(d) U',
U unit upper triangular: then F P F' is F U with the same d, and noise and measurement are rank-one changes that keep
d >= 0 (Bierman, Factorization Methods for Discrete Sequential Estimation, 1977). P is symmetric and positive by
construction, after any number of steps.

Imported when a `Navigator` is made, since numba takes a while to load; without numba the same functions run.
"""

from __future__ import annotations

import contextlib
import math
from typing import Any

from gyrocal.units import DEG_TO_RAD, RAD_TO_DEG

# Navigation states; the first nine stand at the index of their errors. The constants are what eqs. 10 and 6 use:
# B_rb, B_s, 1/(1 + S_R), 1/(1 + S_L), D.
X, Y, PSI, PHI, BIAS, SCALE, RIGHT, LEFT, WIDTH = range(9)
# Memory: last speed and rate, running median of the time step, the last row, steps without encoders, the last
# temperature, whether the robot has moved; how far what follows its motion has come, 0 to 1; how long its wheels have stood;
# whether speed and rate of the row before may be from before a gap.
SPEED, RATE, PERIOD, LAST_LEFT, LAST_RIGHT, LAST_GYRO, BLIND, LAST_TEMP, MOVED, MOVING, STOOD, TORN = range(
    9, 21
)
MEMORY_SIZE = 21

# Figures: variances per metre, per radian turned, per second, per second, of a measurement; gate squared; gap factor;
# bias in deg/s, its slope and the temperature where it holds, its step once the robot has moved, and while it moves, with
# a lag, s, until no tick has come for so long, s; the constants D, 1/(1 + S_R), 1/(1 + S_L), B_s of the robot file, and what
# turns to the left and to the right are multiplied by before B_s.
SLIP, TURN, WALK, BIAS_WALK, MEASUREMENT, GATE, GAP, STATIC_BIAS = range(8)
SLOPE, TEMP, STEP, SHAKEN, SHAKEN_LAG, TICK_WAIT = range(8, 14)
FILE_WIDTH, FILE_RIGHT, FILE_LEFT, FILE_SCALE, LEFTWARD, RIGHTWARD = range(14, 20)
#: A wheel that goes further in a row moves, m: above the rounding of a log in metres, below any tick.
MOVED_M = 1e-6

# Columns of what is reported: nine states, their standard deviations, innovation and its deviation, the model's drift.
STD, NU, DRIFT, COLUMNS = 9, 18, 20, 21

# What is counted.
ROWS, UPDATES, GATED, GAPS, DUPLICATES, REPEATED, NO_ENCODERS, NO_GYRO = range(8)
COUNTS_SIZE = 8

# Rows of the matrix `m`: U, d, and scratch: U'h, the same times d, gain, a noise vector.
D, SEEN, WEIGHED, GAIN, V = range(9, 14)
MATRIX_ROWS = 14
_N = 9

# The paper's order (eq. 12): place here, and unit outside.
PLACE = (X, Y, PSI, RIGHT, LEFT, WIDTH, PHI, SCALE, BIAS)
UNIT = (1.0, 1.0, RAD_TO_DEG, 1.0, 1.0, 1.0, RAD_TO_DEG, 1.0, RAD_TO_DEG)

#: Share by which the running median follows a longer or shorter time step.
_MEDIAN_STEP = 0.01

njit: Any = None
with contextlib.suppress(ImportError):
    from numba import njit
#: The loop allocates nothing; counting references to its arrays would take longer than the arithmetic.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}


def part(function: Any) -> Any:
    """A function compiled into the loop that calls it; as it is without numba."""
    return njit(function, forceinline=True, **_OPTIONS) if njit else function


def whole(function: Any) -> Any:
    """The loop compiled, and kept on disk where Python may write its cache; as it is without numba."""
    if njit is None:
        return function
    try:
        return njit(function, cache=True, **_OPTIONS)
    except RuntimeError:  # no writable place for the cache: compile in each process
        return njit(function, **_OPTIONS)


@part
def usable(nav: Any, figures: Any, counts: Any, dt: float, left: float, right: float, gyro: float) -> Any:
    """What may be used of a row: (anything, encoders, gyro)."""
    first = counts[ROWS] == 0
    counts[ROWS] += 1
    if dt == 0.0 and not first:
        counts[DUPLICATES] += 1
        if left == nav[LAST_LEFT] and right == nav[LAST_RIGHT] and gyro == nav[LAST_GYRO]:
            counts[REPEATED] += 1
            return False, False, False
    gap = nav[PERIOD] > 0.0 and dt > figures[GAP] * nav[PERIOD]
    if gap:
        counts[GAPS] += 1
        nav[TORN] = 1.0
    if nav[PERIOD] == 0.0:
        nav[PERIOD] = dt
    elif dt > nav[PERIOD]:
        nav[PERIOD] *= 1.0 + _MEDIAN_STEP
    elif dt > 0.0:
        nav[PERIOD] *= 1.0 - _MEDIAN_STEP
    encoders = math.isfinite(left) and math.isfinite(right)
    if not encoders:
        counts[NO_ENCODERS] += 1
    finite = math.isfinite(gyro)
    if not finite:
        counts[NO_GYRO] += 1
    nav[LAST_LEFT], nav[LAST_RIGHT], nav[LAST_GYRO] = left, right, gyro
    return True, encoders, finite and not gap


@part
def rate_of(nav: Any, figures: Any, dt: float, gyro: float, temp: float, left: float, right: float) -> Any:
    """The gyro's rate in rad/s without the bias that the robot file knows, nor what its sides differ by."""
    if math.isfinite(temp):
        nav[LAST_TEMP] = temp
    nav[STOOD] += dt
    if abs(left) > MOVED_M or abs(right) > MOVED_M:
        nav[MOVED], nav[STOOD] = 1.0, 0.0
    moving = nav[MOVED] if nav[STOOD] < figures[TICK_WAIT] else 0.0
    lag = figures[SHAKEN_LAG]
    nav[MOVING] = moving + (nav[MOVING] - moving) * math.exp(-dt / lag) if lag > 0.0 else moving
    known = figures[STATIC_BIAS] + figures[SLOPE] * (nav[LAST_TEMP] - figures[TEMP])
    known += figures[STEP] * nav[MOVED] + figures[SHAKEN] * nav[MOVING]
    rate = (gyro - known) * DEG_TO_RAD
    return rate * (figures[LEFTWARD] if rate > 0.0 else figures[RIGHTWARD])


@part
def _add_noise(m: Any, variance: float, x: float, y: float, psi: float, phi: float, bias: float) -> None:
    """Add variance v v' to P, v given by its entries: a rank-one change (Agee and Turner)."""
    m[V, X], m[V, Y], m[V, PSI], m[V, PHI], m[V, BIAS] = x, y, psi, phi, bias
    last = BIAS if bias != 0.0 else (PHI if phi != 0.0 else PSI)
    for j in range(last, -1, -1):
        here = m[V, j]
        grown = m[D, j] + variance * here * here
        if grown > 0.0:
            gain = variance * here / grown
            variance *= m[D, j] / grown
            m[D, j] = grown
            for i in range(j):
                m[V, i] -= here * m[i, j]
                m[i, j] += gain * m[V, i]


@part
def _propagate(
    m: Any, sin: float, cos: float, right: float, left: float, width: float, rate: float, dt: float, encoders: bool,
    gyro: bool,
) -> None:  # fmt: skip
    """U becomes F U: the errors over one step (eqs. 8, 9, 11), at the mid-point heading."""
    travel, turned = 0.5 * (right + left), (right - left) / width
    known = 0.5 if encoders else 0.0
    for j in range(PSI, _N):
        by_gyro = dt * (m[BIAS, j] + rate * m[SCALE, j])
        by_wheels = (right * m[RIGHT, j] - left * m[LEFT, j] - turned * m[WIDTH, j]) / width
        psi = by_wheels if encoders else by_gyro
        heading = m[PSI, j] + 0.5 * psi
        along = known * (right * m[RIGHT, j] + left * m[LEFT, j])
        m[X, j] += cos * along - sin * travel * heading
        m[Y, j] += sin * along + cos * travel * heading
        m[PSI, j] += psi
        m[PHI, j] += by_gyro if gyro or not encoders else by_wheels


@part
def _spread(
    m: Any, figures: Any, sin: float, cos: float, right: float, left: float, width: float, dt: float, blind: float,
    gyro: bool,
) -> None:  # fmt: skip
    """Process noise of one step: of the wheels, the gyro and its bias."""
    travel, turned = 0.5 * (right + left), (right - left) / width
    x, y = -0.5 * sin * travel, 0.5 * cos * travel  # a heading error grows evenly over the step
    walk = figures[WALK] * dt if gyro else 0.0
    if blind == 0.0:
        per_m, phi = 1.0 / width, 0.0 if gyro else 1.0
        along_x, along_y = 0.5 * cos, 0.5 * sin
        slip = figures[SLIP]
        _add_noise(m, slip * abs(right), along_x + x * per_m, along_y + y * per_m, per_m, phi * per_m, 0.0)
        _add_noise(m, slip * abs(left), along_x - x * per_m, along_y - y * per_m, -per_m, -phi * per_m, 0.0)
        if figures[TURN] > 0.0:
            _add_noise(m, figures[TURN] * abs(turned), x, y, 1.0, phi, 0.0)
        _add_noise(m, walk, 0.0, 0.0, 0.0, 1.0, 0.0)
    else:
        # A held reading errs the same way in each step: variance m^2 in all after m steps, as sum of 2 m - 1.
        grown = 2.0 * blind - 1.0
        _add_noise(m, grown * travel * travel, cos, sin, 0.0, 0.0, 0.0)
        _add_noise(m, walk if gyro else grown * turned * turned, x, y, 1.0, 1.0, 0.0)
    if figures[BIAS_WALK] > 0.0:
        _add_noise(m, figures[BIAS_WALK] * dt, 0.0, 0.0, 0.0, 0.0, 1.0)


@part
def _advance(
    nav: Any, m: Any, figures: Any, dt: float, left: float, right: float, rate: float, encoders: bool, gyro: bool,
    filtering: bool,
) -> None:  # fmt: skip
    """One step of odometry (eqs. 6, 7) and gyro heading (eq. 10), and of the errors' covariance."""
    width = nav[WIDTH]
    if encoders:
        nav[BLIND] = 0.0
        u_right, u_left = nav[RIGHT] * right, nav[LEFT] * left  # eq. 7
    else:
        nav[BLIND] += 1.0
        u_right = u_left = nav[SPEED] * dt
    travel = 0.5 * (u_right + u_left)
    if gyro:
        nav[RATE] = rate
    by_gyro = (nav[SCALE] * nav[RATE] + nav[BIAS]) * dt  # eq. 10
    by_wheels = (u_right - u_left) / width if encoders else by_gyro
    if encoders and not gyro:
        by_gyro = by_wheels
    # Eq. 6 at the mid-point heading: its start heading would lag half a step in every turn.
    middle = nav[PSI] + 0.5 * by_wheels if filtering else nav[PHI] + 0.5 * by_gyro
    sin, cos = math.sin(middle), math.cos(middle)
    if filtering:
        # Eq. 8 holds at the true distances. Measured ones bring their slip into the matrix, where it looks like
        # knowledge of D apart from B_s; the gyro's turn is far cleaner than the wheels'.
        u_right, u_left = travel + 0.5 * width * by_gyro, travel - 0.5 * width * by_gyro
        _propagate(m, sin, cos, u_right, u_left, width, nav[RATE], dt, encoders, gyro)
        _spread(m, figures, sin, cos, u_right, u_left, width, dt, nav[BLIND], gyro)
    nav[X] += cos * travel
    nav[Y] += sin * travel
    nav[PSI] += by_wheels
    nav[PHI] += by_gyro
    if encoders and dt > 0.0:
        nav[SPEED] = travel / dt


@part
def _project(m: Any, variance: float) -> Any:
    """Variance of psi - phi (eq. 13) measured with `variance`; leaves U'h and d U'h in their rows."""
    for j in range(PSI, _N):
        m[SEEN, j] = m[PSI, j] - m[PHI, j]
        m[WEIGHED, j] = m[D, j] * m[SEEN, j]
        variance += m[SEEN, j] * m[WEIGHED, j]
    return variance


@part
def _update(m: Any, variance: float) -> Any:
    """Bierman's update of U and d; leaves the gain in its row, to be divided by the number returned."""
    for i in range(_N):
        m[GAIN, i] = 0.0
    inverse = 1.0 / variance
    for j in range(PSI, _N):
        weighed = m[WEIGHED, j]
        slope = -m[SEEN, j] * inverse
        before = variance
        variance += m[SEEN, j] * weighed
        inverse = 1.0 / variance
        m[D, j] *= before * inverse
        for i in range(j):
            held = m[i, j]
            m[i, j] += m[GAIN, i] * slope
            m[GAIN, i] += held * weighed
        m[GAIN, j] = weighed
    return variance


@part
def _measure(nav: Any, m: Any, figures: Any, counts: Any) -> Any:
    """Measurement z = psi - phi (eq. 13), its gate, and the feedback; returns the variance of z."""
    z = nav[PSI] - nav[PHI]
    expected = _project(m, figures[MEASUREMENT])
    counts[UPDATES] += 1
    if z * z > figures[GATE] * expected:
        # Both headings are integrals, so a jump between them stays: dropping it would bar every later one too.
        # Wheels slip, gyros do not: psi takes the jump, and the constants are left alone.
        counts[GATED] += 1
        _add_noise(m, z * z - expected, 0.0, 0.0, 1.0, 0.0, 0.0)
        _project(m, figures[MEASUREMENT])
    z /= _update(m, figures[MEASUREMENT])
    for i in range(RIGHT):
        nav[i] -= m[GAIN, i] * z
    nav[RIGHT] *= 1.0 - m[GAIN, RIGHT] * z  # the constant is 1 / (1 + S)
    nav[LEFT] *= 1.0 - m[GAIN, LEFT] * z
    nav[WIDTH] -= m[GAIN, WIDTH] * z
    return expected


@part
def _report(nav: Any, m: Any, figures: Any, out: Any, k: int, filtering: bool) -> None:
    """States and standard deviations in the paper's order (eq. 12), degrees; errors of the assumed figures."""
    out[k, 0], out[k, 1], out[k, 2] = nav[X], nav[Y], nav[PSI] * RAD_TO_DEG
    out[k, 3], out[k, 4] = figures[FILE_RIGHT] / nav[RIGHT] - 1.0, figures[FILE_LEFT] / nav[LEFT] - 1.0
    out[k, 5] = figures[FILE_WIDTH] - nav[WIDTH]
    out[k, 6], out[k, 7] = nav[PHI] * RAD_TO_DEG, figures[FILE_SCALE] - nav[SCALE]
    out[k, 8] = 0.0 - nav[BIAS] * RAD_TO_DEG
    for c in range(_N if filtering else 0):
        variance = m[D, PLACE[c]]
        for j in range(PLACE[c] + 1, _N):
            variance += m[PLACE[c], j] * m[PLACE[c], j] * m[D, j]
        out[k, STD + c] = UNIT[c] * math.sqrt(variance)


def covariance(_: Any, m: Any, __: Any) -> Any:
    """Covariance of the errors in the paper's order, radians, shape (9, 9)."""
    half = m[PLACE, :] * m[D] ** 0.5
    return half @ half.T


@part
def _take(
    nav: Any, m: Any, figures: Any, counts: Any, dt: float, left: float, right: float, gyro: float, temp: float,
    out: Any, k: int, filtering: bool,
) -> None:  # fmt: skip
    """One row, and what is reported of it."""
    some, encoders, good = usable(nav, figures, counts, dt, left, right, gyro)
    if some:
        rate = rate_of(nav, figures, dt, gyro, temp, left, right)
        _advance(nav, m, figures, dt, left, right, rate, encoders, good, filtering)
    for c in range(STD, COLUMNS):
        out[k, c] = math.nan
    if filtering and some and encoders and good and dt > 0.0:
        out[k, NU] = (nav[PSI] - nav[PHI]) * RAD_TO_DEG
        out[k, NU + 1] = math.sqrt(_measure(nav, m, figures, counts)) * RAD_TO_DEG
    _report(nav, m, figures, out, k, filtering)


@whole
def navigate(
    nav: Any, m: Any, figures: Any, counts: Any, dt: Any, left: Any, right: Any, gyro: Any, temp: Any, smooth: Any,
    out: Any, filtering: bool,
) -> None:  # fmt: skip
    """Run rows through odometry and filter; `nav`, `m` and `counts` carry what is known to the next block.

    `dt`, `left`, `right`, `gyro`, `temp` have shape (n,), in s, m, m, deg/s, deg C; `smooth` is for the model. Out, shape
    (n, `COLUMNS`): states in the paper's order, their standard deviations, psi - phi before the update and its
    standard deviation, deg, NaN where nothing was measured. Not `filtering`: heading from the gyro alone.
    """
    for k in range(dt.size):
        _take(nav, m, figures, counts, dt[k], left[k], right[k], gyro[k], temp[k], out, k, filtering)


@whole
def step(
    nav: Any, m: Any, figures: Any, counts: Any, dt: float, left: float, right: float, gyro: float, temp: float,
    smooth: float, out: Any, filtering: bool,
) -> Any:  # fmt: skip
    """`navigate` for a single row: the same numbers; whether they are finite."""
    _take(nav, m, figures, counts, dt, left, right, gyro, temp, out, 0, filtering)
    total = nav[X] + nav[Y] + nav[PSI] + nav[PHI]
    for i in range(_N):
        total += m[D, i]
    return math.isfinite(total)
