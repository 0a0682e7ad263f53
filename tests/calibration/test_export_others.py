"""What Kalibr, PX4 and ArduPilot get, evaluated as their own documents say, against the coefficient file."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from gyrocal.calibration.export_others import ardupilot, kalibr, px4
from gyrocal.cli import gyrocal_command
from gyrocal.errors import DataError
from gyrocal.fusion.coefficients import Noise, load_coefficients

SAMPLE = Path(__file__).parents[2] / "sample_data" / "coefficients.json"
FILE = load_coefficients(SAMPLE)
TEMPS_C = np.linspace(*FILE.valid.temp_c, 7)
BIAS_RAD_S = np.radians(FILE.surface.output_dps(np.zeros(7), TEMPS_C))
NOISE = {
    "angle_random_walk": {"value": 0.3, "at_most": None},
    "rate_random_walk": {"value": 6.0, "at_most": None},
}


def test_kalibr_has_its_own_units() -> None:
    text = kalibr(replace(FILE, figures={"noise": NOISE}), 200.0)
    values = dict(line.split("#")[0].split(":") for line in text.splitlines() if ":" in line.split("#")[0])
    # 0.3 deg/sqrt(h) is 0.005 deg/s/sqrt(Hz); 6 deg/h/sqrt(h) is 6/3600/60 deg/s per root second.
    assert float(values["gyroscope_noise_density"]) == pytest.approx(math.radians(0.005), rel=1e-6)
    assert float(values["gyroscope_random_walk"]) == pytest.approx(math.radians(6.0 / 3600 / 60), rel=1e-6)
    assert float(values["update_rate"]) == 200.0


def test_kalibr_takes_a_bound_and_says_so() -> None:
    noise = NOISE | {"rate_random_walk": {"value": None, "at_most": 9.0}}
    assert "not resolved, its 95 % bound" in kalibr(replace(FILE, figures={"noise": noise}), 200.0)


def test_kalibr_takes_the_walk_of_a_file_from_before_there_were_figures() -> None:
    text = kalibr(replace(FILE, figures={}), 200.0)
    walk = FILE.noise.angle_random_walk_deg_per_rt_h
    assert walk is not None
    assert f"gyroscope_noise_density: {math.radians(walk[0] / 60.0):.6e}" in text
    assert "# gyroscope_random_walk: these coefficients say nothing of it" in text


def test_kalibr_is_refused_without_noise() -> None:
    with pytest.raises(DataError, match="wants an angle random walk"):
        kalibr(replace(FILE, figures={}, noise=Noise()), 200.0)
    with pytest.raises(DataError, match="give --rate-hz"):
        kalibr(replace(FILE, figures={"noise": NOISE}, sensor={"model": "x"}), None)


@pytest.mark.parametrize(("axis", "number", "sign"), [("-z", 2, -1.0), ("x", 0, 1.0)])
def test_px4_evaluates_to_the_bias(axis: str, number: int, sign: float) -> None:
    lines = [line.split("\t") for line in px4(FILE, axis, 1).splitlines() if not line.startswith("#")]  # type: ignore[arg-type]
    values = {name: float(value) for _, _, name, value, _ in lines}
    delta = TEMPS_C - values["TC_G1_TREF"]
    found = sum(values[f"TC_G1_X{k}_{number}"] * delta**k for k in range(4))
    np.testing.assert_allclose(sign * found, BIAS_RAD_S, atol=1e-6)


def test_ardupilot_evaluates_to_the_change_of_the_bias_from_35_degrees() -> None:
    lines = [line.split(",") for line in ardupilot(FILE, "z", 0).splitlines() if not line.startswith("#")]
    values = {name: float(value) for name, value in lines}
    delta = TEMPS_C - 35.0
    found = 1e-6 * sum(values[f"INS_TCAL1_GYR{k}_Z"] * delta**k for k in (1, 2, 3))
    at_35 = np.radians(FILE.surface.output_dps(0.0, 35.0))
    np.testing.assert_allclose(found, BIAS_RAD_S - at_35, atol=1e-6)


def test_the_command_writes_them(tmp_path: Path) -> None:
    target = tmp_path / "gyro.param"
    words = ["export", str(SAMPLE), "--format", "ardupilot", "--axis=-z", "-o", str(target)]
    done = CliRunner().invoke(gyrocal_command, words)
    assert done.exit_code == 0, done.output
    assert "INS_TCAL1_GYR1_Z," in target.read_text()
