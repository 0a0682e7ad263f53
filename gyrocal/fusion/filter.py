"""Odometry and the nine-state indirect feedback Kalman filter (paper eqs. 6 to 13): the compiled loop.

Conventions: x forward, y left, counter-clockwise (REP 103): the paper's Y is x here, its X is y. Radians inside.
An *error* is estimate minus truth, as in eqs. 7 and 11: measured U_R = (1 + S_R) true U_R, assumed
D = true D + dD, assumed B = true B + dB.

Order of the states inside: x, y, psi, phi, S_R, S_L, dD, dB_s, dB_rb. Psi and phi stand before the constants that
drive them, so the transition matrix F is unit upper triangular. The covariance is carried as P = U diag(d) U',
U unit upper triangular: then F P F' is F U with the same d, and noise and measurement are rank-one changes that
keep d >= 0 (Bierman, Factorization Methods for Discrete Sequential Estimation, 1977). P is symmetric and
positive by construction, after any number of steps.

Imported at the first step of a `Navigator`, since numba takes a while to load; without numba the same functions
run as they stand.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

try:
    from numba import njit
except ImportError:
    COMPILED = False

    def jit(function: Any) -> Any:
        """The function as it is."""
        return function

else:
    COMPILED = True

    def jit(function: Any) -> Any:
        """The function compiled, kept on disk where Python may write its cache."""
        try:
            return njit(function, cache=True, error_model="numpy")
        except RuntimeError:  # no writable place for the cache: compile in each process
            return njit(function, error_model="numpy")


# Navigation states; the first nine stand at the index of their errors. Parameters are what eqs. 6 and 10 use:
# 1/(1 + S_R), 1/(1 + S_L), D, B_s, B_rb.
X, Y, PSI, PHI, RIGHT, LEFT, WIDTH, SCALE, BIAS = range(9)
# Memory between steps: last speed and gyro rate, running median of the time step, the last row, steps without encoders.
SPEED, RATE, PERIOD, LAST_LEFT, LAST_RIGHT, LAST_GYRO, BLIND = range(9, 16)
NAVIGATION_SIZE = 16

# Noise figures, squared: per metre, per radian turned, per second, per second, of one measurement; gate; gap factor.
SLIP, TURN, WALK, BIAS_WALK, MEASUREMENT, GATE, GAP = range(7)

# What is counted.
ROWS, UPDATES, GATED, GAPS, DUPLICATES, REPEATED, NO_ENCODERS, NO_GYRO = range(8)

#: Share by which the running median follows a longer or shorter time step.
_MEDIAN_STEP = 0.01

_STATES = 9


@jit
def _usable(nav: Any, noise: Any, counts: Any, dt: float, left: float, right: float, gyro: float) -> Any:
    """What may be used of a row: (anything, encoders, gyro, a measurement)."""
    first = counts[ROWS] == 0
    counts[ROWS] += 1
    if dt == 0.0 and not first:
        counts[DUPLICATES] += 1
        if left == nav[LAST_LEFT] and right == nav[LAST_RIGHT] and gyro == nav[LAST_GYRO]:
            counts[REPEATED] += 1
            return False, False, False, False
    gap = nav[PERIOD] > 0.0 and dt > noise[GAP] * nav[PERIOD]
    if gap:
        counts[GAPS] += 1
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
    usable = finite and not gap
    return True, encoders, usable, encoders and usable and dt > 0.0


@jit
def _add_noise(u: Any, d: Any, vector: Any, variance: float, last: int) -> None:
    """Add variance * vector vector' to P (Agee and Turner); entries of `vector` after `last` are zero; it is used up."""
    for j in range(last, -1, -1):
        grown = d[j] + variance * vector[j] * vector[j]
        if grown > 0.0:
            gain = variance * vector[j] / grown
            variance *= d[j] / grown
            d[j] = grown
            for i in range(j):
                vector[i] -= vector[j] * u[i, j]
                u[i, j] += gain * vector[i]


@jit
def _propagate(
    u: Any, sin: float, cos: float, travel: float, u_right: float, u_left: float, by_wheels: Any, by_gyro: Any
) -> None:
    """U becomes F U: the errors over one step (eqs. 8, 9, 11, at the mid-point heading).

    `by_wheels` (5,) and `by_gyro` (5,) are the derivatives of the increments of psi and phi by the parameters.
    """
    for j in range(PSI, _STATES):
        turned_psi = 0.0
        turned_phi = 0.0
        for i in range(5):
            turned_psi += by_wheels[i] * u[RIGHT + i, j]
            turned_phi += by_gyro[i] * u[RIGHT + i, j]
        heading = u[PSI, j] + 0.5 * turned_psi
        stretch = 0.5 * (u_right * u[RIGHT, j] + u_left * u[LEFT, j])
        u[X, j] += cos * stretch - sin * travel * heading
        u[Y, j] += sin * stretch + cos * travel * heading
        u[PSI, j] += turned_psi
        u[PHI, j] += turned_phi


@jit
def _heading_row(
    row: Any, wheels: bool, u_right: float, u_left: float, width: float, omega: float, dt: float
) -> None:
    """Derivatives of a heading increment by (S_R, S_L, dD, dB_s, dB_rb): eq. 8 or eq. 11."""
    row[:] = 0.0
    if wheels:
        row[0] = u_right / width
        row[1] = -u_left / width
        row[2] = (u_left - u_right) / (width * width)
    else:
        row[3] = omega * dt
        row[4] = dt


@jit
def _add_process_noise(
    u: Any, d: Any, noise: Any, sin: float, cos: float, wheels: Any, dt: float, blind: float, gyro: bool, v: Any
) -> None:
    """Noise of one step: wheels along and across, gyro, bias. `wheels`: travel, turn, U_R, U_L, D."""
    travel, turned, u_right, u_left, width = wheels
    along_x, along_y = 0.5 * cos, 0.5 * sin
    across_x, across_y = -0.5 * sin * travel, 0.5 * cos * travel  # a heading error grows evenly over the step
    if blind == 0.0:
        # Independent errors of the two wheels: w_R + w_L along, (w_R - w_L) / D in heading; they correlate.
        right, left = noise[SLIP] * abs(u_right), noise[SLIP] * abs(u_left)
        both = right + left
        heading = both / (width * width) + noise[TURN] * abs(turned)
        if heading > 0.0:
            cross = (right - left) / width / heading
            v[X], v[Y] = across_x + cross * along_x, across_y + cross * along_y
            v[PSI], v[PHI] = 1.0, 0.0 if gyro else 1.0
            _add_noise(u, d, v, heading, PHI)
            v[X], v[Y] = along_x, along_y
            _add_noise(u, d, v, both - cross * cross * heading, Y)
    else:
        # A held reading errs the same way in each step: variances m^2 in all after m steps, as sum of 2 m - 1.
        grown = 2.0 * blind - 1.0
        v[X], v[Y] = cos, sin
        _add_noise(u, d, v, grown * travel * travel, Y)
        if not gyro:
            v[X], v[Y], v[PSI], v[PHI] = across_x, across_y, 1.0, 1.0
            _add_noise(u, d, v, grown * turned * turned, PHI)
    if gyro:
        v[X], v[Y], v[PSI], v[PHI] = 0.0, 0.0, 0.0, 1.0
        if blind > 0.0:
            v[X], v[Y], v[PSI] = across_x, across_y, 1.0
        _add_noise(u, d, v, noise[WALK] * dt, PHI)
    if noise[BIAS_WALK] > 0.0:
        v[:] = 0.0
        v[BIAS] = 1.0
        _add_noise(u, d, v, noise[BIAS_WALK] * dt, BIAS)


@jit
def _advance(
    nav: Any, u: Any, d: Any, noise: Any, row: Any, encoders: bool, gyro: bool, filtering: bool, scratch: Any
) -> None:
    """One step of odometry (eqs. 6, 7) and gyro heading (eq. 10), and of the errors' covariance."""
    dt, left, right, rate = row
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
        if encoders and gyro:
            # Eq. 8 holds at the true distances. Measured ones bring their slip into the matrix, where it looks like
            # knowledge of D apart from B_s; the gyro's turn is far cleaner than the wheels'.
            u_right, u_left = travel + 0.5 * width * by_gyro, travel - 0.5 * width * by_gyro
        _heading_row(scratch[0], encoders, u_right, u_left, width, nav[RATE], dt)
        _heading_row(scratch[1], encoders and not gyro, u_right, u_left, width, nav[RATE], dt)
        if encoders:
            _propagate(u, sin, cos, travel, u_right, u_left, scratch[0], scratch[1])
        else:
            _propagate(u, sin, cos, travel, 0.0, 0.0, scratch[0], scratch[1])
        wheels = (travel, by_wheels, u_right, u_left, width)
        _add_process_noise(u, d, noise, sin, cos, wheels, dt, nav[BLIND], gyro, scratch[2])
    nav[X] += cos * travel
    nav[Y] += sin * travel
    nav[PSI] += by_wheels
    nav[PHI] += by_gyro
    if encoders and dt > 0.0:
        nav[SPEED] = travel / dt


@jit
def _project(u: Any, d: Any, variance: float, f: Any, v: Any) -> Any:
    """Variance of psi - phi (eq. 13) with a measurement of `variance`; f = U'h, v = d f."""
    for j in range(PSI, _STATES):
        f[j] = u[PSI, j] - u[PHI, j]
        v[j] = d[j] * f[j]
        variance += f[j] * v[j]
    return variance


@jit
def _measure(nav: Any, u: Any, d: Any, noise: Any, counts: Any, scratch: Any) -> Any:
    """Measurement z = psi - phi (eq. 13), its gate, and the feedback; returns z and its variance."""
    f, v, gain = scratch[0], scratch[1], scratch[2]
    z = nav[PSI] - nav[PHI]
    variance = _project(u, d, noise[MEASUREMENT], f, v)
    counts[UPDATES] += 1
    if z * z > noise[GATE] * variance:
        # Both headings are integrals, so a jump between them stays: dropping it would bar every later one too.
        # Wheels slip, gyros do not: psi takes the jump, and the constants are left alone.
        counts[GATED] += 1
        gain[:] = 0.0
        gain[PSI] = 1.0
        _add_noise(u, d, gain, z * z - variance, PSI)
        _project(u, d, noise[MEASUREMENT], f, v)
    gain[:] = 0.0
    alpha = noise[MEASUREMENT]
    for j in range(PSI, _STATES):
        before = alpha
        alpha += f[j] * v[j]
        d[j] *= before / alpha
        slope = -f[j] / before
        gain[j] = v[j]
        for i in range(j):
            held = u[i, j]
            u[i, j] += gain[i] * slope
            gain[i] += held * v[j]
    z_scaled = z / alpha
    for i in range(RIGHT):
        nav[i] -= gain[i] * z_scaled
    nav[RIGHT] *= 1.0 - gain[RIGHT] * z_scaled  # the parameter is 1 / (1 + S)
    nav[LEFT] *= 1.0 - gain[LEFT] * z_scaled
    for i in range(WIDTH, _STATES):
        nav[i] -= gain[i] * z_scaled
    return z, variance


@jit
def navigate(
    nav: Any,
    u: Any,
    d: Any,
    noise: Any,
    dt: Any,
    left: Any,
    right: Any,
    gyro: Any,
    track: Any,
    variance: Any,
    innovation: Any,
    counts: Any,
) -> None:
    """Run rows through odometry and filter; `nav`, `u`, `d` and `counts` carry the state to the next block.

    Parameters
    ----------
    nav : ndarray, shape (NAVIGATION_SIZE,)
        Navigation states and memory, changed in place.
    u, d : ndarray, shapes (9, 9) and (9,)
        Covariance of the errors, ``P = U diag(d) U'``, changed in place.
    noise : ndarray, shape (7,)
    dt, left, right, gyro : ndarray, shape (n,), s, m, m, rad/s
    track : ndarray, shape (n, up to 9)
        Out: the first navigation states after each row.
    variance : ndarray, shape (n, 9) or (0, 9)
        Out: diagonal of P after each row. No rows: no filter, heading from the gyro alone.
    innovation : ndarray, shape (n, 2)
        Out: psi - phi before the update, rad, and its variance; NaN where nothing was measured.
    counts : ndarray of int64, shape (8,)
    """
    filtering = variance.shape[0] > 0
    scratch = np.zeros((3, _STATES))
    for k in range(dt.size):
        some, encoders, usable, measured = _usable(nav, noise, counts, dt[k], left[k], right[k], gyro[k])
        if some:
            row = (dt[k], left[k], right[k], gyro[k])
            _advance(nav, u, d, noise, row, encoders, usable, filtering, scratch)
        for j in range(track.shape[1]):
            track[k, j] = nav[j]
        if filtering:
            innovation[k, 0] = np.nan
            innovation[k, 1] = np.nan
            if some and measured:
                innovation[k, 0], innovation[k, 1] = _measure(nav, u, d, noise, counts, scratch)
                for j in range(track.shape[1]):
                    track[k, j] = nav[j]
            for i in range(_STATES):
                total = 0.0
                for j in range(i, _STATES):
                    total += u[i, j] * u[i, j] * d[j]
                variance[k, i] = total
