"""The robot file: strict, complete after defaults, and it says which figures are defaults."""

from __future__ import annotations

from pathlib import Path

import pytest

from gyrocal.errors import InputError, ProfileError
from gyrocal.records.robot import INITIAL_STD_DEFAULTS, NOISE_DEFAULTS, format_robot, read_robot


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "robot.toml"
    path.write_text(text)
    return path


def test_a_full_file_reads_back(tmp_path: Path) -> None:
    initial = {key: 0.125 * (i + 1) for i, key in enumerate(INITIAL_STD_DEFAULTS)}
    noise = {key: 0.5 * (i + 1) for i, key in enumerate(NOISE_DEFAULTS)}
    robot = read_robot(write(tmp_path, format_robot(0.6, (2e-5, 3e-5), 8.0, initial, noise)))
    assert (robot.wheel_separation_m, robot.metres_per_tick, robot.static_s) == (0.6, (2e-5, 3e-5), 8.0)
    assert (robot.initial_std, robot.noise, robot.defaulted) == (initial, noise, ())


def test_what_the_file_does_not_give_is_named(tmp_path: Path) -> None:
    robot = read_robot(write(tmp_path, "wheel_separation_m = 0.5\n[noise]\nheading_noise_deg = 0.3\n"))
    assert robot.static_s == 10.0
    assert robot.metres_per_tick is None
    assert robot.initial_std["wheel_separation_m"] == pytest.approx(0.05)
    assert "static_s = 10" in robot.defaulted
    assert "initial_std.wheel_separation_m = 0.05" in robot.defaulted
    assert not any("heading_noise_deg" in text for text in robot.defaulted)
    assert len(robot.defaulted) == 1 + len(INITIAL_STD_DEFAULTS) + len(NOISE_DEFAULTS) - 1


def test_one_tick_size_serves_both_sides(tmp_path: Path) -> None:
    assert read_robot(
        write(tmp_path, "wheel_separation_m = 1\nmetres_per_tick = 2e-5\n")
    ).metres_per_tick == (2e-5, 2e-5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "static_s = 0\n",
            "wheel_separation_m is missing; allowed: the effective distance between left and right wheels, in metres, above 0.",
        ),
        ("wheel_separation_m = 0\n", "wheel_separation_m is 0; allowed: a number, above 0."),
        ("wheel_separation_m = true\n", "wheel_separation_m is True; allowed: a number, above 0."),
        ("wheel_separation_m = nan\n", "wheel_separation_m is nan; allowed: a number, above 0."),
        ("wheel_separation_m = 1\nstatic_s = -1\n", "static_s is -1; allowed: a number, 0 or above."),
        ("wheel_separation_m = 1\ntrack = 2\n", "unknown key track; allowed: wheel_separation_m"),
        (
            "wheel_separation_m = 1\n[noise]\nspeed = 2\n",
            "unknown key noise.speed; allowed: wheel_slip_m_per_rt_m",
        ),
        ("wheel_separation_m = 1\nnoise = 2\n", "noise is not a table; allowed: [noise] with"),
        (
            "wheel_separation_m = 1\n[initial_std]\nx_m = 'a'\n",
            "initial_std.x_m is 'a'; allowed: a number, 0 or above.",
        ),
        (
            "wheel_separation_m = 1\nmetres_per_tick = [1, 2, 3]\n",
            "metres_per_tick is [1, 2, 3]; allowed: one number, or [LEFT, RIGHT], above 0.",
        ),
        ("wheel_separation_m = 1\nmetres_per_tick = [0, 1]\n", "metres_per_tick is 0"),
        ("wheel_separation_m", "is not TOML"),
    ],
)
def test_bad_files_are_refused_with_what_is_allowed(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ProfileError) as error:
        read_robot(write(tmp_path, text))
    assert message in str(error.value)


def test_a_missing_file_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_robot(tmp_path / "none.toml")
