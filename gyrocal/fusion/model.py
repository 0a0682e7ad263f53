"""The drive model as an error-state filter: the paper's nine states and what real wheels and gyros add to them.

One observation a node: encoder heading minus gyro heading (eq. 13), at nodes of fixed spacing, so that the rate of the
log does not matter. Beside the nine errors of eq. 12 stand the encoders' tick and clock error, which does not
accumulate; three Gauss-Markov parts of the gyro's bias, which make up its 1/f noise; the wander of the effective track
and of one wheel against the other; and what the bias of a rest differs by from that in motion, as it may of a gyro that
is shaken. Wheels slip in proportion to distance and turn. At rest only the gyro makes an error: its bias is seen.

Without the filter the encoders' turn is used at rest only: heading from the gyro alone, with the bias of its rests.

The covariance is carried for the difference psi - phi in the place of psi: what is measured then stays small, while
the heading's own variance may grow without limit. Signs, units and the first nine places as in `filter`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

# isort: off
from gyrocal.fusion.filter import (
    BIAS, BIAS_WALK, BLIND, DRIFT, FILE_LEFT, FILE_RIGHT, FILE_SCALE, FILE_WIDTH, GATE, GATED, LAST_TEMP, LEFT, MOVED, MOVED_M,
    MOVING, NU, PHI, PLACE, PSI, RATE, RIGHT, SCALE, SLIP, SPEED, STD, STEP, TEMP, TORN, TURN, UNIT, UPDATES, WALK, WIDTH, X, Y,
    MEMORY_SIZE as PAPER_SIZE, part, rate_of, usable, whole,
)  # fmt: skip

# isort: on
from gyrocal.fusion.static_bias import TURNED_DPS
from gyrocal.physics.drive import FLICKER_TAUS_S, TICK_WAITS_S
from gyrocal.physics.slip import widened
from gyrocal.units import DEG_TO_RAD, RAD_TO_DEG

_, STILL_S = TICK_WAITS_S
#: Spacing of the nodes at rest, s: a bias by a shorter one is mostly noise, and turns the whole way before it. Wheels
#: that move before a node is full take it back: the robot may have turned before they did.
REST_NODE_S = 1.0
#: Variance of a measurement, rad^2: none but rounding, since the tick error is a state.
_ROUNDING = 1e-12

# Error states after the nine.
TICK, FLICKER_1, FLICKER_2, FLICKER_3, TRACK, WHEELS, REST, _N = range(9, 17)
# Their estimates, and what a node has gathered: time, distance, way of right over left wheel, turn by the gyro as it
# came, turn as it was navigated, variance of turns without a gyro, rows that lack something, time at rest once the robot
# has moved; then time since the wheels moved, and by how much the smoothed gyro heading is ahead of the plain one.
AHEAD = PAPER_SIZE
E, G1, G2, G3, STRAY, PULL, AT_REST, SINCE, TRAVEL = range(AHEAD, AHEAD + 9)
ACROSS, BY_GYRO, TURNED, UNSEEN, LOST, RESTED, STILL, SMOOTHED = range(AHEAD + 9, AHEAD + 17)
# What heading and position change by for a gyro scale wrong by one; how far the temperature was from `TEMP`.
HEADING_BY_SCALE, X_BY_SCALE, Y_BY_SCALE, AWAY_C, MEMORY_SIZE = range(AHEAD + 17, AHEAD + 22)

# Figures after those of `filter`: spacing of the nodes, s; variance of the tick error, rad^2; of the clocks, s^2; of each
# part of the flicker, (rad/s)^2; of what wanders, track and wheels, and its memories, s; of the bias step and of that while moving, (rad/s)^2; of its slope,
# (rad/s/deg C)^2; of the scales of the gyro and of both wheels, which no heading difference shows; law of slip,
# amplitude, shape.
(
    SPACING, TICKS, JITTER, FLICKER, TRACK_VARIANCE, WHEELS_VARIANCE, TRACK_S, WHEELS_S, STEP_VARIANCE, SHAKEN_VARIANCE, SLOPE_VARIANCE, SCALE_VARIANCE,
    WAY_VARIANCE, LAW, AMPLITUDE, SHAPE,
) = range(20, 36)  # fmt: skip

# Rows of the matrix: the covariance, then scratch.
_GAIN, _V, MATRIX_ROWS = range(_N, _N + 3)

_widened = part(widened)


@part
def _moves(left: float, right: float) -> Any:
    """Whether a wheel moves in a row; one of which nothing is known does not."""
    return abs(left) > MOVED_M or abs(right) > MOVED_M


@part
def _row(
    nav: Any, figures: Any, dt: float, left: float, right: float, rate: float, encoders: bool, gyro: bool
) -> None:
    """Dead reckoning over a row, and what the node gathers."""
    rested = nav[MOVED] - nav[MOVING]
    bias = nav[BIAS] + nav[G1] + nav[G2] + nav[G3] + rested * nav[AT_REST]
    way_before, turn_before = nav[SPEED] * dt, (nav[SCALE] * nav[RATE] + bias) * dt
    if encoders:
        nav[BLIND] = 0.0
        u_right, u_left = nav[RIGHT] * right, nav[LEFT] * left  # eq. 7
        travel, across = 0.5 * (u_right + u_left), u_right - u_left
        if dt > 0.0:
            nav[SPEED] = travel / dt
    else:
        nav[BLIND] += 1.0
        travel, across = nav[SPEED] * dt, 0.0
    if gyro:
        nav[RATE] = rate
    turned = (nav[SCALE] * nav[RATE] + bias) * dt  # eq. 10
    if not gyro and encoders:
        turned = across / nav[WIDTH]
        nav[UNSEEN] += figures[TURN] * abs(turned) + figures[SLIP] * abs(2.0 * travel) / nav[WIDTH] ** 2
    elif not gyro:
        nav[UNSEEN] += (2.0 * nav[BLIND] - 1.0) * turned * turned
    if not encoders:
        across = turned * nav[WIDTH]
    if not (encoders and gyro):
        nav[LOST] += 1.0
    # Rows of a second hold whole turns: the chord of an arc, and aside of it what speed and turn rate change by since
    # the row before (the sculling of inertial navigation, of two samples).
    chord = travel * (1.0 - turned * turned / 24.0)
    aside = (travel * turn_before - way_before * turned) / 12.0
    if nav[TORN] > 0.0:
        # What was before a gap tells nothing of the course within it, and in it a robot may turn many times.
        half = 0.5 * turned
        chord, aside = travel * (math.sin(half) / half if half != 0.0 else 1.0), 0.0
        nav[TORN] = 0.0 if encoders and gyro and dt > 0.0 else 1.0
    sin, cos = math.sin(nav[PHI] + 0.5 * turned), math.cos(nav[PHI] + 0.5 * turned)
    nav[X] += cos * chord - sin * aside
    nav[Y] += sin * chord + cos * aside
    nav[PHI] += turned
    by_scale = nav[RATE] * dt if gyro else turned
    nav[X_BY_SCALE] -= sin * chord * (nav[HEADING_BY_SCALE] + 0.5 * by_scale)
    nav[Y_BY_SCALE] += cos * chord * (nav[HEADING_BY_SCALE] + 0.5 * by_scale)
    nav[HEADING_BY_SCALE] += by_scale
    nav[SINCE] += dt
    nav[TRAVEL] += travel
    nav[ACROSS] += across
    nav[TURNED] += turned
    nav[BY_GYRO] += by_scale
    nav[RESTED] += rested * dt
    nav[STILL] = 0.0 if _moves(left, right) or not encoders else nav[STILL] + dt


@part
def _transit(
    p: Any, i: int, sin: float, cos: float, right: float, left: float, width: float, raw: float, dt: float, rested: float, fade: Any,
) -> None:  # fmt: skip
    """The errors of one column of P over a node (eqs. 8, 9, 11), at the mid-point heading."""
    travel, turned = 0.5 * (right + left), (right - left) / width
    bias = p[BIAS, i] + p[FLICKER_1, i] + p[FLICKER_2, i] + p[FLICKER_3, i]
    by_gyro = raw * p[SCALE, i] + dt * bias + rested * p[REST, i]
    across = right * p[RIGHT, i] - left * p[LEFT, i] - turned * p[WIDTH, i]
    by_wheels = across / width + turned * p[TRACK, i] + travel / width * p[WHEELS, i]
    heading, along = p[PHI, i] + 0.5 * by_gyro, 0.5 * (right * p[RIGHT, i] + left * p[LEFT, i])
    p[X, i] += cos * along - sin * travel * heading
    p[Y, i] += sin * along + cos * travel * heading
    p[PSI, i] += by_wheels - by_gyro
    p[PHI, i] += by_gyro
    for j in range(TICK, REST):
        p[j, i] *= fade[j - TICK]


@part
def _noise(p: Any, variance: float, x: float, y: float, psi: float, phi: float) -> None:
    """Add variance v v' to P, v given by its entries."""
    p[_V, X], p[_V, Y], p[_V, PSI], p[_V, PHI] = x, y, psi, phi
    for i in range(PHI + 1):
        for j in range(PHI + 1):
            p[i, j] += variance * p[_V, i] * p[_V, j]


@part
def _spread(
    nav: Any, p: Any, figures: Any, sin: float, cos: float, right: float, left: float, width: float, rest: bool,
    quiet: bool, fade: Any,
) -> None:  # fmt: skip
    """Process noise of a node."""
    dt, travel, turned = nav[SINCE], 0.5 * (right + left), nav[TURNED]
    _noise(p, figures[WALK] * dt + nav[UNSEEN], -0.5 * sin * travel, 0.5 * cos * travel, -1.0, 1.0)
    if nav[BLIND] > 0.0:
        _noise(p, (2.0 * nav[BLIND] - 1.0) * travel * travel, cos, sin, 0.0, 0.0)
    p[BIAS, BIAS] += figures[BIAS_WALK] * dt
    for j in range(FLICKER_1, REST):
        level = figures[FLICKER if j < TRACK else TRACK_VARIANCE + j - TRACK]
        p[j, j] += level * (1.0 - fade[j - TICK] * fade[j - TICK])
    if quiet and not rest:
        # Wheels that have just stopped may still turn by less than a tick, which the encoders do not see.
        p[TICK, TICK] += turned * turned
    elif not quiet:
        _noise(p, figures[SLIP] * abs(right), 0.5 * cos, 0.5 * sin, 1.0 / width, 0.0)
        _noise(p, figures[SLIP] * abs(left), 0.5 * cos, 0.5 * sin, -1.0 / width, 0.0)
        p[PSI, PSI] += figures[TURN] * abs(turned)
        rate = turned / dt
        p[TICK, TICK] += figures[TICKS] + figures[JITTER] * rate * rate


@part
def _variance(p: Any) -> Any:
    """Variance of psi - phi with its tick error."""
    return p[PSI, PSI] + 2.0 * p[PSI, TICK] + p[TICK, TICK] + _ROUNDING


@part
def _measure(nav: Any, p: Any, figures: Any, counts: Any, rest: bool) -> Any:
    """Measurement z = psi - phi (eq. 13), its gate, and the feedback; returns innovation and its variance."""
    nu = nav[PSI] - nav[PHI] - nav[SMOOTHED] - nav[E]
    expected = variance = _variance(p)
    counts[UPDATES] += 1
    if nu * nu > figures[GATE] * variance:
        if rest and abs(nu) < TURNED_DPS * DEG_TO_RAD * nav[SINCE]:
            # Wheels at rest do not slip: the bias is another, the next nodes tell which, and the way before stays as it is.
            p[BIAS, BIAS] += (nu * nu - variance) / nav[SINCE] ** 2
            _forget(nav, p)
            return nu, expected
        # Wheels slip, gyros do not: psi takes the jump.
        counts[GATED] += 1
        p[PSI, PSI] += nu * nu - variance
        variance = _variance(p)
    for i in range(_N):
        p[_GAIN, i] = (p[i, PSI] + p[i, TICK]) / variance
    for i in range(_N):
        for j in range(_N):
            p[i, j] -= variance * p[_GAIN, i] * p[_GAIN, j]
    for i in (X, Y, PHI, BIAS, SCALE, WIDTH):
        nav[i] -= p[_GAIN, i] * nu
    nav[PSI] -= (p[_GAIN, PSI] + p[_GAIN, PHI]) * nu  # P holds the difference
    nav[RIGHT] *= 1.0 - p[_GAIN, RIGHT] * nu
    nav[LEFT] *= 1.0 - p[_GAIN, LEFT] * nu
    nav[E] += p[_GAIN, TICK] * nu
    for i in range(FLICKER_1, _N):
        nav[E + i - TICK] -= p[_GAIN, i] * nu
    return nu, expected


@part
def _forget(nav: Any, p: Any) -> None:
    """Take what the wheels say from here on only: the encoders' heading starts anew at the gyro's."""
    for i in range(_N):
        p[PSI, i] = p[i, PSI] = p[TICK, i] = p[i, TICK] = 0.0
    nav[PSI], nav[E] = nav[PHI] + nav[SMOOTHED], 0.0


@part
def _node(nav: Any, p: Any, figures: Any, counts: Any, rest: bool, filtering: bool) -> Any:
    """Errors over the rows since the last node, and the measurement at their end: innovation and variance, or 0."""
    dt, turned, width = nav[SINCE], nav[TURNED], nav[WIDTH]
    quiet = nav[STILL] >= (1.0 - 1e-9) * dt
    rate, speed = turned / dt * RAD_TO_DEG, nav[TRAVEL] / dt
    wider = 1.0 + figures[AMPLITUDE] * _widened(figures[LAW], rate, speed, width, figures[SHAPE])
    nav[PSI] += nav[ACROSS] / (width * wider) * (1.0 + nav[STRAY]) + nav[PULL] * nav[TRAVEL] / width
    fast, slow, slowest = FLICKER_TAUS_S
    fade = (
        1.0 if quiet else 0.0, math.exp(-dt / fast), math.exp(-dt / slow), math.exp(-dt / slowest),
        math.exp(-dt / figures[TRACK_S]), math.exp(-dt / figures[WHEELS_S]),
    )  # fmt: skip
    middle = nav[PHI] - 0.5 * turned
    sin, cos = math.sin(middle), math.cos(middle)
    # The wheels' errors act on the true turn. At rest that is none, and the gyro's noise in its place would look like
    # a wrong track.
    half = 0.0 if quiet else 0.5 * width * turned
    right, left = nav[TRAVEL] + half, nav[TRAVEL] - half
    for _ in range(2):  # F P F' is F (F P)', for P is symmetric
        for i in range(_N):
            _transit(p, i, sin, cos, right, left, width, nav[BY_GYRO], dt, nav[RESTED], fade)
        for i in range(_N):
            for j in range(i):
                p[i, j], p[j, i] = p[j, i], p[i, j]
    _spread(nav, p, figures, sin, cos, right, left, width, rest, quiet, fade)
    for j in range(E, AT_REST):
        nav[j] *= fade[j - E]
    nu = expected = 0.0
    if nav[LOST] > 0.0 or not (filtering or rest):
        _forget(nav, p)
    else:
        nu, expected = _measure(nav, p, figures, counts, rest)
    for i in range(SINCE, STILL):
        nav[i] = 0.0
    return nu, expected


@part
def _resting(nav: Any) -> Any:
    """Whether all rows of the node are of a robot that stands."""
    return nav[SINCE] > 0.0 and nav[STILL] >= STILL_S + nav[SINCE]


@part
def _full(nav: Any, figures: Any, dt: float) -> Any:
    """Whether the node ends with this row: half a row early is as good as half a row late."""
    spacing = figures[SPACING]
    if spacing < REST_NODE_S and _resting(nav):
        spacing = REST_NODE_S
    return nav[SINCE] > 0.0 and nav[SINCE] + 0.5 * dt >= spacing


@part
def _report(nav: Any, p: Any, figures: Any, out: Any, k: int) -> None:
    """States and standard deviations in the paper's order (eq. 12), degrees; errors of the assumed figures."""
    out[k, 0], out[k, 1], out[k, 2] = nav[X], nav[Y], nav[PSI] * RAD_TO_DEG
    out[k, 3], out[k, 4] = figures[FILE_RIGHT] / nav[RIGHT] - 1.0, figures[FILE_LEFT] / nav[LEFT] - 1.0
    out[k, 5] = figures[FILE_WIDTH] - nav[WIDTH]
    out[k, 6], out[k, 7] = nav[PHI] * RAD_TO_DEG, figures[FILE_SCALE] - nav[SCALE]
    out[k, 8] = -(nav[BIAS] + nav[G1] + nav[G2] + nav[G3]) * RAD_TO_DEG
    out[k, DRIFT] = math.sqrt(max(p[X, X] + p[Y, Y], 0.0))
    for c in range(9):
        variance = p[PLACE[c], PLACE[c]]
        if c == 2:
            variance += p[PHI, PHI] + 2.0 * p[PSI, PHI]
        if c < 2:
            variance += figures[WAY_VARIANCE] * nav[c] * nav[c]
            variance += figures[SCALE_VARIANCE] * nav[X_BY_SCALE + c] * nav[X_BY_SCALE + c]
        for i in range(FLICKER_1, FLICKER_3 + 1 if c == 8 else 0):
            variance += 2.0 * p[BIAS, i] + p[i, FLICKER_1] + p[i, FLICKER_2] + p[i, FLICKER_3]
        if c == 2 or c == 6:
            variance += figures[SCALE_VARIANCE] * nav[HEADING_BY_SCALE] * nav[HEADING_BY_SCALE]
        out[k, STD + c] = UNIT[c] * math.sqrt(max(variance, 0.0))


def initial_covariance(std: Any, figures: Any) -> Any:
    """Matrix of the loop, from standard deviations in the paper's order, radians, shape (9,)."""
    p = np.zeros((MATRIX_ROWS, _N))
    p[PLACE, PLACE] = std**2
    # The encoders cannot tell the gyro's scale from the track: the track is the one that agrees with this gyro, and
    # what the scale does to the pose is carried beside.
    p[SCALE, SCALE] = 0.0
    fading = range(FLICKER_1, REST)
    p[fading, fading] = figures[[FLICKER] * 3 + [TRACK_VARIANCE, WHEELS_VARIANCE]]
    return p


def covariance(nav: Any, p: Any, figures: Any) -> Any:
    """Covariance of the errors in the paper's order, radians, shape (9, 9)."""
    rows = np.zeros((9, _N))
    rows[range(9), PLACE] = 1.0
    rows[2, PHI] = 1.0
    rows[8, [FLICKER_1, FLICKER_2, FLICKER_3]] = 1.0
    by_scale, by_way = np.zeros(9), np.zeros(9)
    by_scale[[0, 1, 2, 6]] = nav[[X_BY_SCALE, Y_BY_SCALE, HEADING_BY_SCALE, HEADING_BY_SCALE]]
    by_way[:2] = nav[:2]
    unseen = figures[SCALE_VARIANCE] * np.outer(by_scale, by_scale)
    return rows @ p[:_N] @ rows.T + unseen + figures[WAY_VARIANCE] * np.outer(by_way, by_way)


@part
def _warm(nav: Any, p: Any, figures: Any) -> None:
    """A slope of the bias is known to its deviation only: the further from where the bias holds, the less of the bias."""
    away = abs(nav[LAST_TEMP] - figures[TEMP])
    if away > nav[AWAY_C]:
        p[BIAS, BIAS] += figures[SLOPE_VARIANCE] * (away * away - nav[AWAY_C] * nav[AWAY_C])
        nav[AWAY_C] = away


@part
def _set_off(p: Any, figures: Any) -> None:
    """What motion adds to the bias is known to its deviations; whether a rest still has the step, rests tell."""
    step, shaken = figures[STEP] * DEG_TO_RAD, figures[SHAKEN_VARIANCE]
    p[BIAS, BIAS] += figures[STEP_VARIANCE] + shaken
    p[REST, REST] += step * step + shaken
    p[BIAS, REST] = p[REST, BIAS] = -shaken


@part
def _take(
    nav: Any, p: Any, figures: Any, counts: Any, dt: float, left: float, right: float, gyro: float, temp: float,
    smooth: float, out: Any, k: int, filtering: bool,
) -> None:  # fmt: skip
    """One row, the node that ends with it, and what is reported."""
    moved = nav[MOVED]
    some, encoders, good = usable(nav, figures, counts, dt, left, right, gyro)
    out[k, NU] = out[k, NU + 1] = math.nan
    if some:
        nu = expected = 0.0
        rate = rate_of(nav, figures, dt, gyro, temp, left, right)
        if nav[MOVED] > moved:
            _set_off(p, figures)
        _warm(nav, p, figures)
        if _resting(nav) and _moves(left, right):
            nu, expected = _node(nav, p, figures, counts, False, filtering)
        _row(nav, figures, dt, left, right, rate, encoders, good)
        nav[SMOOTHED] += smooth * dt * DEG_TO_RAD
        if _full(nav, figures, dt):
            nu, expected = _node(nav, p, figures, counts, _resting(nav), filtering)
        if expected > 0.0:
            out[k, NU], out[k, NU + 1] = nu * RAD_TO_DEG, math.sqrt(expected) * RAD_TO_DEG
    _report(nav, p, figures, out, k)


@whole
def navigate(
    nav: Any, p: Any, figures: Any, counts: Any, dt: Any, left: Any, right: Any, gyro: Any, temp: Any, smooth: Any,
    out: Any, filtering: bool,
) -> None:  # fmt: skip
    """Run rows through dead reckoning and filter, as `gyrocal.fusion.filter.navigate` does.

    `smooth`, shape (n,), deg/s: what smoothing the gyro as the encoders are smoothed adds to its rate.
    """
    for k in range(dt.size):
        _take(
            nav, p, figures, counts, dt[k], left[k], right[k], gyro[k], temp[k], smooth[k], out, k, filtering
        )


@whole
def step(
    nav: Any, p: Any, figures: Any, counts: Any, dt: float, left: float, right: float, gyro: float, temp: float,
    smooth: float, out: Any, filtering: bool,
) -> Any:  # fmt: skip
    """`navigate` for a single row: the same numbers; whether they are finite."""
    _take(nav, p, figures, counts, dt, left, right, gyro, temp, smooth, out, 0, filtering)
    # What the node has gathered goes into the covariance at its end, by products.
    node = nav[TRAVEL] * nav[TRAVEL] + nav[ACROSS] * nav[ACROSS] + nav[TURNED] * nav[TURNED]
    total = nav[X] + nav[Y] + nav[PSI] + nav[PHI] + node * node
    for i in range(_N):
        total += p[i, i]
    return math.isfinite(total)
