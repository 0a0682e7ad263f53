"""The robot file: strict, complete after defaults, and it says which figures are defaults."""

from __future__ import annotations

from pathlib import Path

import pytest

from gyrocal.errors import InputError, ProfileError
from gyrocal.fusion import FilterNoise, RobotParameters
from gyrocal.records.robot import SECTIONS, _ranges, format_robot, read_robot

DOCUMENT = Path(__file__).parents[2] / "bench_profiles/robot_file.md"


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "robot.toml"
    path.write_text(text)
    return path


def documented() -> str:
    """The robot file that the document shows."""
    lines = DOCUMENT.read_text().splitlines()
    return "\n".join(line.strip() for line in lines if line.startswith("    ") or not line)


def test_the_documented_file_has_every_key_and_reads_back(tmp_path: Path) -> None:
    robot = read_robot(write(tmp_path, documented()))
    named = {f"{section}.{key}" for section, kind in SECTIONS.items() for key in _ranges(kind)}
    assert {key for key in named if not key.endswith("_std")} - robot.given == set()
    again = read_robot(write(tmp_path, format_robot(robot)))
    assert again == robot
    assert robot.parameters.gyro.delay_s == 0.12
    assert robot.metres_per_tick == (2.6e-5, 2.6e-5)


def test_a_file_of_the_first_schema_loads(tmp_path: Path) -> None:
    robot = read_robot(
        write(tmp_path, "wheel_separation_m = 0.5\nstatic_s = 0\n[noise]\nheading_noise_deg = 0.3\n")
    )
    assert robot.noise["heading_noise_deg"] == 0.3
    assert robot.parameters == RobotParameters(0.5, static_s=0.0, noise=FilterNoise(heading_noise_deg=0.3))


def test_standard_deviations_stand_beside_their_figures(tmp_path: Path) -> None:
    text = "wheel_separation_m = 0.5\n[gyro]\ndelay_s = 0.1\ndelay_s_std = 0.01\n[noise]\ntick_m = 1e-3\ntick_m_std = 1e-4\n"
    robot = read_robot(write(tmp_path, text))
    assert robot.parameters.gyro.delay_s_std == 0.01
    assert robot.noise_std == {"tick_m": 1e-4}
    assert "tick_m_std = 0.0001" in format_robot(robot)


def test_what_the_file_does_not_give_is_named_and_not_written(tmp_path: Path) -> None:
    robot = read_robot(write(tmp_path, "wheel_separation_m = 0.5\n[noise]\nheading_noise_deg = 0.3\n"))
    assert robot.static_s == 10.0
    assert robot.metres_per_tick is None
    assert robot.initial_std["wheel_separation_m"] == pytest.approx(0.05)
    assert "static_s = 10" in robot.defaulted
    assert "initial_std.wheel_separation_m = 0.05" in robot.defaulted
    assert not any("heading_noise_deg" in text for text in robot.defaulted)
    assert len(robot.defaulted) == len(robot.initial_std) + len(robot.noise)
    assert "static_s" not in format_robot(robot)


def test_figures_given_anew_are_written_and_the_others_stay(tmp_path: Path) -> None:
    before = read_robot(write(tmp_path, "wheel_separation_m = 0.5\n[noise]\ntick_m = 0.002\n"))
    robot = before.with_figures({"gyro.delay_s": 0.12, "wheel_separation_m": 0.52, "slip.law": "curvature"})
    again = read_robot(write(tmp_path, format_robot(robot)))
    assert again == robot
    assert (again.wheel_separation_m, again.parameters.gyro.delay_s) == (0.52, 0.12)
    assert again.noise["tick_m"] == 0.002
    with pytest.raises(ProfileError, match=r"unknown key gyro.late; allowed: bias_dps"):
        before.with_figures({"gyro.late": 1.0})


def test_one_tick_size_serves_both_sides(tmp_path: Path) -> None:
    assert read_robot(
        write(tmp_path, "wheel_separation_m = 1\nmetres_per_tick = 2e-5\n")
    ).metres_per_tick == (2e-5, 2e-5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("wheel_separation_m = 0\n", "wheel_separation_m is 0; allowed: a number, 0.001 to 10."),
        ("wheel_separation_m = true\n", "wheel_separation_m is True; allowed: a number"),
        ("wheel_separation_m = nan\n", "wheel_separation_m is nan; allowed: a number"),
        ("wheel_separation_m = 1e154\n", "wheel_separation_m is 1e+154; allowed: a number, 0.001 to 10."),
        (f"wheel_separation_m = {'9' * 400}\n", f"wheel_separation_m is {'9' * 40}; allowed: a number"),
        (f"wheel_separation_m = {'9' * 5000}\n", "is not TOML"),
        ("wheel_separation_m = 1\nstatic_s = -1\n", "static_s is -1; allowed: a number, 0 to 86400."),
        (
            'wheel_separation_m = "0.6"\n',
            "wheel_separation_m is the text '0.6'; allowed: a number, 0.001 to 10, without quotes.",
        ),
        ("wheel_separation_m = 1\ntrack = 2\n", "unknown key track; allowed: schema, wheel_separation_m"),
        (
            "wheel_separation_m = 1\n[noise]\nspeed = 2\n",
            "unknown key noise.speed; allowed: wheel_slip_m_per_rt_m",
        ),
        ("wheel_separation_m = 1\nnoise = 2\n", "noise is not a table; allowed: [noise] with"),
        (
            "wheel_separation_m = 1\n[initial_std]\nx_m = 'a'\n",
            "initial_std.x_m is the text 'a'; allowed: a number, 0 to 10000, without quotes.",
        ),
        ("wheel_separation_m = 1\n[slip]\nlaw = 'none'\n", "law is 'none'; allowed: turn_rate, curvature"),
        ("wheel_separation_m = 1\n[slip]\nlaw = 2\n", "slip.law is 2; allowed: a name in quotes."),
        (
            "wheel_separation_m = 1\nmetres_per_tick = [1, 2, 3]\n",
            "metres_per_tick is [1, 2, 3]; allowed: one number, or [LEFT, RIGHT], above 0.",
        ),
        ("wheel_separation_m = 57\n", "wheel_separation_m is 57; allowed: a number, 0.001 to 10."),
        ("wheel_separation_m = 1\nmetres_per_tick = [0, 1]\n", "metres_per_tick is 0"),
        (
            "schema = 'gyrocal-robot/3'\nwheel_separation_m = 1\n",
            "schema is 'gyrocal-robot/3'; allowed: gyrocal-robot/2",
        ),
        ("wheel_separation_m", "is not TOML"),
    ],
)
def test_bad_files_are_refused_with_what_is_allowed(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ProfileError) as error:
        read_robot(write(tmp_path, text))
    assert message in str(error.value)


def test_what_is_nothing_but_rounding_is_zero(tmp_path: Path) -> None:
    text = "wheel_separation_m = 1\n[noise]\ntick_m = 1e-300\n[encoders]\nleft_scale = -6.6e-13\n"
    robot = read_robot(write(tmp_path, text))
    assert robot.parameters.noise.tick_m == robot.parameters.encoders.left_scale == 0.0


def test_a_missing_file_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_robot(tmp_path / "none.toml")
