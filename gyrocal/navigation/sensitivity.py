"""From one wrong coefficient or noise to centimetres of return error, on the paper's square."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.fusion import Coefficients, Navigator, RobotParameters
from gyrocal.navigation.path import Motion, TruePath, drive, square_via_points
from gyrocal.navigation.simulate import CCW, CW, SimulatedRobot, Spread, encoder_steps
from gyrocal.physics.gyro import GyroModel, GyroStream
from gyrocal.physics.surface import SHAPE
from gyrocal.units import DEG_TO_RAD, S_PER_MIN

Floats = NDArray[np.float64]
GyroError = Callable[[TruePath, Floats], Floats]

#: Means of the paper's Table II over both directions, cm, in the order of `CONDITIONS`.
PAPER_CM = (107.7, 43.2, 16.3, 12.2)
_DT_S = 0.1
_STATIC_S = 10.0
_DRAWS = 40


@dataclass(frozen=True)
class Sensitivity:
    """What one unit of an error does, everything else being perfect and the gyro calibrated.

    Attributes
    ----------
    no_filter_cm, filter_cm : float
        Root mean square over both directions (and draws) of the return error that one `unit` causes.
    here : float
        Its size in the simulation, in units; NaN where it has none.
    """

    source: str
    unit: str
    no_filter_cm: float
    filter_cm: float
    here: float
    calibrated: bool = True

    @property
    def for_paper(self) -> float:
        """Units that alone would cause the paper's mean error without filter: 16.3 cm, uncalibrated 107.7 cm."""
        paper_cm = PAPER_CM[2 if self.calibrated else 0]
        return paper_cm / self.no_filter_cm if self.no_filter_cm > 0.05 else float("nan")


class _Drives:
    """Perfect drives both ways, and what a navigator makes of them when something is wrong."""

    def __init__(self, spread: Spread, parameters: RobotParameters) -> None:
        motion = Motion()
        self.paths = {d: drive(square_via_points(motion, d), motion, _DT_S, _STATIC_S) for d in (CW, CCW)}
        self.spread, self.parameters = spread, parameters
        self.clean = {
            (d, f): self._end(d, None, self._wheels(d), f) for d in (CW, CCW) for f in (False, True)
        }

    def _wheels(
        self, direction: int, left: float = 0.0, right: float = 0.0, separation: float = 0.0
    ) -> tuple[Floats, Floats]:
        path = self.paths[direction]
        width_m = self.spread.wheel_separation_m * (1.0 + separation)
        half = 0.5 * width_m * path.turn_deg * DEG_TO_RAD
        return (path.distance_m - half) * (1.0 + left), (path.distance_m + half) * (1.0 + right)

    def _end(
        self, direction: int, error: GyroError | None, wheels: tuple[Floats, Floats], filtering: bool
    ) -> Floats:
        """Where the navigator believes to be at the end, minus where it is, m, shape (2,)."""
        path = self.paths[direction]
        rate = path.turn_deg / _DT_S
        gyro = rate if error is None else rate + error(path, rate)
        rest = path.t_s <= _STATIC_S
        navigator = Navigator(
            self.parameters,
            kind="paper",
            filtering=filtering,
            static_bias_dps=float(np.mean(gyro[rest])),
            estimate_scale=False,
        )
        track = navigator.run(path.t_s, *wheels, gyro)
        return np.array([track.x_m[-1] - path.x_m[-1], track.y_m[-1] - path.y_m[-1]])

    def response(self, direction: int, error: GyroError) -> Floats:
        """Displacement of the end by an error of the gyro, without the filter, m, shape (2,)."""
        return self._end(direction, error, self._wheels(direction), False) - self.clean[direction, False]

    def gyro(self, error: GyroError, draws: int = 1) -> tuple[float, float]:
        """Root mean square return error in cm, without and with the filter."""
        return self._rms(lambda d, f: self._end(d, error, self._wheels(d), f), draws)

    def wheels(self, left: float, right: float, separation: float) -> tuple[float, float]:
        """The same for errors of the wheels."""
        return self._rms(lambda d, f: self._end(d, None, self._wheels(d, left, right, separation), f), 1)

    def counted(self, spread: Spread, rng: np.random.Generator) -> tuple[float, float]:
        """The same for random errors of the encoders."""
        robot = SimulatedRobot(spread, 0.0, 0.0, spread.wheel_separation_m)
        return self._rms(lambda d, f: self._end(d, None, encoder_steps(self.paths[d], robot, rng), f), _DRAWS)

    def _rms(self, end: Callable[[int, bool], Floats], draws: int) -> tuple[float, float]:
        result = []
        for filtering in (False, True):
            squares = [
                np.sum((end(d, filtering) - self.clean[d, filtering]) ** 2)
                for d in (CW, CCW)
                for _ in range(draws)
            ]
            result.append(100.0 * float(np.sqrt(np.mean(squares))))
        return result[0], result[1]


def sensitivities(
    spread: Spread, parameters: RobotParameters, model: GyroModel, rng: np.random.Generator
) -> list[Sensitivity]:
    """Return error by physical input: gyro, temperature, noise, wheels."""
    drives = _Drives(spread, parameters)

    def after_rest(path: TruePath, rate_dps: Floats) -> Floats:
        return np.where(path.t_s > _STATIC_S, 1e-3, 0.0)

    gyro: list[tuple[str, str, GyroError, float]] = [
        ("gyro bias that the static mean misses", "1 mdeg/s", after_rest, np.nan),
        ("gyro bias drift", "1 mdeg/s per min", lambda p, r: 1e-3 * p.t_s / S_PER_MIN, np.nan),
        ("gyro scale factor", "0.1 %", lambda p, r: 1e-3 * r, np.nan),
        ("term of 2nd order in rate", "1 mdeg/s at 30 deg/s", lambda p, r: 1e-3 * (r / 30.0) ** 2, np.nan),
        ("term of 3rd order in rate", "1 mdeg/s at 30 deg/s", lambda p, r: 1e-3 * (r / 30.0) ** 3, np.nan),
        (
            "uncalibrated: nonlinearity (cubic about the best line)",
            "0.1 % rms of 100 deg/s",
            # u^3 - 0.6 u, the cubic about its best line over -1..1, has an rms of 0.151.
            lambda p, r: 0.1 / 0.151 * ((r / 100.0) ** 3 - 0.6 * (r / 100.0)),
            5.0,
        ),
        (
            "uncalibrated: temperature 10 °C from where the scale factor is right (2 % over 60 °C)",
            "10 °C",
            lambda p, r: 0.02 / 6.0 * r,
            1.0,
        ),
        (
            "uncalibrated: temperature drift in the run (0.2 deg/s over 60 °C)",
            "0.1 °C",
            lambda p, r: 0.2 / 600.0 * p.t_s / p.t_s[-1],
            2.0,
        ),
    ]
    result = [
        Sensitivity(name, unit, *drives.gyro(error), here, not name.startswith("uncalibrated"))
        for name, unit, error, here in gyro
    ]
    result += _noises(drives, model, rng)
    wheels = (
        ("scale of both wheels", "1 %", (0.01, 0.01, 0.0), 100 * spread.wheel_scale_std),
        (
            "scale of right against left wheel",
            "0.1 %",
            (-5e-4, 5e-4, 0.0),
            1000 * spread.wheel_scale_std * 2**0.5,
        ),
        ("effective wheel separation", "1 %", (0.0, 0.0, 0.01), 100 * spread.separation_std),
    )
    result += [Sensitivity(name, unit, *drives.wheels(*errors), here) for name, unit, errors, here in wheels]
    still = replace(spread, bumps_per_m=0.0, turn_slip_deg_per_rt_deg=0.0, separation_run_std=0.0)
    bumps = replace(still, bumps_per_m=spread.bumps_per_m)
    slip = replace(still, turn_slip_deg_per_rt_deg=spread.turn_slip_deg_per_rt_deg)
    result.append(Sensitivity("bumps under the wheels", "as simulated", *drives.counted(bumps, rng), 1.0))
    result.append(Sensitivity("slip in turns", "as simulated", *drives.counted(slip, rng), 1.0))
    return result


def _noises(drives: _Drives, model: GyroModel, rng: np.random.Generator) -> list[Sensitivity]:
    flat = replace(model.surface, coefficients_dps=np.zeros(SHAPE))
    quiet = replace(
        model,
        surface=flat,
        angle_random_walk_deg_per_rt_h=0.0,
        bias_instability_deg_per_h=0.0,
        lsb_deg=0.0,
        bandwidth_hz=np.inf,
    )

    def noise(changed: GyroModel) -> GyroError:
        return lambda p, r: GyroStream(changed, rng).samples(_DT_S, np.zeros(r.size), 20.0)

    walk = replace(quiet, angle_random_walk_deg_per_rt_h=5.0 / 60.0)
    flicker = replace(quiet, bias_instability_deg_per_h=1.8)
    return [
        Sensitivity(
            "angle random walk, its share in the static mean included",
            "5 deg/h/√Hz",
            *drives.gyro(noise(walk), _DRAWS),
            model.angle_random_walk_deg_per_rt_h * 12.0,
        ),
        Sensitivity(
            "bias instability (1/f)",
            "1.8 deg/h",
            *drives.gyro(noise(flicker), _DRAWS),
            model.bias_instability_deg_per_h / 1.8,
        ),
    ]


def coefficient_sensitivities(
    spread: Spread, parameters: RobotParameters, coefficients: Coefficients, temp_c: float
) -> list[Sensitivity]:
    """Return error by coefficient c_ij of the surface at one temperature; `here` is its standard error."""
    drives = _Drives(spread, parameters)
    surface = coefficients.surface
    sigma_mdps = 1e3 * np.sqrt(np.diag(coefficients.covariance_dps2))
    result = []
    for k in range(SHAPE[0] * SHAPE[1]):

        def error(path: TruePath, rate: Floats, k: int = k) -> Floats:
            return np.asarray(1e-3 * surface.design(rate, np.full(rate.size, temp_c))[:, k])

        i, j = divmod(k, SHAPE[1])
        result.append(Sensitivity(f"c[{i}][{j}]", "1 mdeg/s", *drives.gyro(error), float(sigma_mdps[k])))
    return result


def calibration_error_cm(
    spread: Spread, parameters: RobotParameters, coefficients: Coefficients, temp_c: float
) -> float:
    """Return error that the covariance of all twelve coefficients together causes, without the filter, cm rms."""
    drives = _Drives(spread, parameters)
    surface = coefficients.surface
    total = 0.0
    for direction in (CW, CCW):
        responses: list[Floats] = []
        for k in range(SHAPE[0] * SHAPE[1]):

            def error(path: TruePath, rate: Floats, k: int = k) -> Floats:
                return np.asarray(1e-3 * surface.design(rate, np.full(rate.size, temp_c))[:, k])

            responses.append(drives.response(direction, error))
        gradient = np.stack(responses, axis=1) / 1e-3
        total += float(np.trace(gradient @ coefficients.covariance_dps2 @ gradient.T))
    return 100.0 * float(np.sqrt(0.5 * total))


def headings() -> Sequence[str]:
    """Columns of a sensitivity table."""
    return (
        "error",
        "unit",
        "return error for one unit, no filter, cm",
        "with filter, cm",
        "units here",
        "units that alone give the paper's 16.3 cm (uncalibrated: 107.7 cm)",
    )
