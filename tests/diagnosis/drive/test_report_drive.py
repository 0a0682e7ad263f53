"""Pictures, words and files of a drive's diagnosis: every law on its own coordinate, paths before and after, in metres."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import pytest
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure

from gyrocal.diagnosis.drive.engine import DriveDiagnosis, Shown, diagnose_drive
from gyrocal.diagnosis.drive.estimates import DriveEstimate
from gyrocal.diagnosis.result import Alternative
from gyrocal.errors import InputError
from gyrocal.records.drive import DriveBlock, format_drive_log
from gyrocal.records.robot import read_robot
from gyrocal.report import style
from gyrocal.report.diagnosis_drive import drive_figures, paths, seconds_of
from gyrocal.report.drive_words import (
    _bias_granted,
    _estimate_sentences,
    _granted,
    _other,
    drive_sentences,
    drive_tables,
)
from tests.diagnosis.drive.fleet import Plan, drive
from tests.diagnosis.drive.world import SEPARATION_M, Hidden, simulate

_FILED = "what the robot file grants"


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory) -> DriveDiagnosis:
    """Encoders and gyro 0.3 s apart."""
    path = tmp_path_factory.mktemp("robot") / "robot.toml"
    path.write_text(f"wheel_separation_m = {SEPARATION_M}\nstatic_s = 0.0\n")
    return diagnose_drive("drive.csv", simulate(Hidden(delay_s=0.3), 13, 150.0), read_robot(path))


@pytest.fixture(scope="module")
def drawn(late: DriveDiagnosis) -> dict[str, Figure]:
    return {p.name: figure for p, figure in drive_figures(late) if figure is not None}


def _points(figure: Figure, panel: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Places and heights of each set of points with error bars."""
    containers = [c for c in figure.axes[panel].containers if isinstance(c, ErrorbarContainer)]
    return [(np.asarray(c[0].get_xdata()), np.asarray(c[0].get_ydata())) for c in containers]


def test_turns_show_before_and_after(drawn: dict[str, Figure]) -> None:
    spread = []
    for panel in drawn["turns"].axes:
        gyro, encoder = (np.asarray(v) for v in panel.lines[1].get_data())
        spread.append(float(np.std(encoder - gyro)))
    assert spread[1] < 0.5 * spread[0]


def test_every_point_has_an_error_bar(drawn: dict[str, Figure]) -> None:
    for name in ("coordinates", "effect_gyro_delay"):
        for panel in range(len(drawn[name].axes)):
            for container in drawn[name].axes[panel].containers:
                assert isinstance(container, ErrorbarContainer)
                lengths = [np.ptp(segment[:, 1]) for segment in container[2][0].get_segments()]
                assert len(lengths) == len(_points(drawn[name], panel)[0][0])
                assert min(lengths) > 0, name


def test_legends_lie_outside_the_data(drawn: dict[str, Figure]) -> None:
    for name, figure in drawn.items():
        figure.draw_without_rendering()
        for axes in figure.axes:
            legend = axes.get_legend()
            assert legend is None or legend.get_window_extent().y0 >= axes.get_window_extent().y1 - 1, name


def test_pictures_are_the_same_each_time(late: DriveDiagnosis) -> None:
    once, again = ({p.name: figure for p, figure in drive_figures(late)} for _ in range(2))
    first, second = once["difference"], again["difference"]
    assert first is not None
    assert second is not None
    assert style.render(first, "png") == style.render(second, "png")


def test_seconds_add_up_to_the_drive(late: DriveDiagnosis) -> None:
    """What is left and what the laws add is the difference as it was logged."""
    seconds = seconds_of(late)
    np.testing.assert_allclose(seconds.after + sum(seconds.law.values()), seconds.before, atol=1e-9)


def test_delay_is_drawn_over_the_change_of_the_turn_rate(drawn: dict[str, Figure]) -> None:
    """Before, the difference is the delay times the turn acceleration; after, nothing of it is left."""
    figure = drawn["effect_gyro_delay"]
    assert "Change of the turn rate" in figure.axes[0].get_xlabel()
    slopes = []
    for panel in (0, 1):
        ((x, y),) = _points(figure, panel)
        slopes.append(float(x @ y / (x @ x)))
    assert slopes == pytest.approx([0.3, 0.0], abs=0.05)


def test_words_say_metres_and_what_could_not_be_told(late: DriveDiagnosis) -> None:
    said = " ".join(drive_sentences(late))
    assert "gyro_delay" in said
    assert "m rms" in said
    tables = {t.name: t for t in drive_tables(late.diagnosis)}
    rows = list(csv.reader(io.StringIO(tables["estimates"].csv)))
    assert rows[0][0] == "Figure"
    assert {"gyro_delay", "gyro_bias", "wheel_asymmetry", "effective_track"} <= {row[0] for row in rows}


def test_a_figure_that_may_be_nothing_is_not_said_to_cost_metres() -> None:
    """A gyro bias of -0.3 ± 0.4 deg/s cost "52 m, not distinct"; an asymmetry of 29 standard deviations was "not distinct" too."""
    figures = (
        DriveEstimate("gyro_bias_in_motion", -0.3, 0.4, "deg/s", 52.0, "gyro", named=False),
        DriveEstimate("skid_slip", 27.6, 1.2, "%", 26.0, "encoders", named=True),
        DriveEstimate("wheel_asymmetry", 0.961, 0.033, "%", 21.0, "encoders", named=False),
    )
    said = _estimate_sentences(
        figures,
        taken_off="the rest at the start takes it off",
        nameless=True,
        scale_withheld=False,
        granted=_FILED,
    )
    assert said == [
        "skid slip 27.6 ± 1.2 %: left in, it moves the path along the encoders' heading by 26 m rms",
        "wheel asymmetry 0.961 ± 0.033 %: left in, it moves the path along the encoders' heading by 21 m rms; not named, for "
        "what is left without a name may be what moves it",
        "Within their uncertainty of nothing: gyro bias in motion -0.30 ± 0.40 deg/s",
    ]
    firm = _estimate_sentences(
        figures[2:],
        taken_off="the rest at the start takes it off",
        nameless=False,
        scale_withheld=False,
        granted=_FILED,
    )
    assert firm[0].endswith("not named, too near its uncertainty or to what the robot file grants")


def test_a_scale_that_is_named_and_not_written_is_said_to_be() -> None:
    figures = (DriveEstimate("gyro_scale", -5.66, 0.71, "%", 13.0, "gyro", named=True),)
    for withheld in (True, False):
        (said,) = _estimate_sentences(
            figures,
            taken_off="the rest at the start takes it off",
            nameless=True,
            scale_withheld=withheld,
            granted=_FILED,
        )
        assert ("not in the robot file" in said) == withheld


def test_what_a_file_has_without_a_name_is_said_to_be_there() -> None:
    figures = (
        DriveEstimate("gyro_asymmetry", 3.05, 0.03, "%", 5.9, "gyro", named=False),
        DriveEstimate("gyro_scale", -0.54, 0.02, "%", 4.0, "gyro", named=False),
    )
    sides, scale = _estimate_sentences(
        figures, taken_off="", nameless=True, scale_withheld=False, granted=_FILED
    )
    assert sides.endswith("by 5.9 m rms; the robot file has it, and the catalogue no name for it")
    assert scale.endswith("by 4 m rms; the robot file has it beside the asymmetry")


def _write(path: Path, log: DriveBlock) -> Path:
    path.write_text(format_drive_log(log))
    return path


def test_the_names_of_paths_stand_inside_their_picture() -> None:
    steep = np.array([complex(k, 12 * k) for k in range(50)], dtype=np.complex128)
    figure = paths(Shown("", 0.6, steep, steep, steep, 0.551, 0.0471, 0.5, 0.01, 0.02))
    style.render(figure, "png")
    (legend,) = figure.legends
    span = legend.get_window_extent().transformed(figure.transFigure.inverted())
    assert span.x0 >= 0.0
    assert span.x1 <= 1.0
    assert len(legend.get_texts()) == 3


def test_command_writes_a_robot_file_and_paths(tmp_path: Path) -> None:
    """Fit on one drive, shown on another; the robot file can be read and holds what was hidden."""
    from gyrocal.commands.diagnose import DiagnoseConfig, write_diagnosis

    robot = tmp_path / "robot.toml"
    robot.write_text("wheel_separation_m = 0.5\nstatic_s = 7.0\n")
    plans = [
        Plan(shape, 5.0, 10.0, arw_dps_rt_s=0.001, truth_m=0.02, effects={"gyro_scale": 2.0})
        for shape in ("random", "lawn")
    ]
    logs = [_write(tmp_path / f"{k}.csv", drive(plan, k)) for k, plan in enumerate(plans)]
    config = DiagnoseConfig(logs[0], tmp_path / "out", robot=robot, others=(logs[1],))
    result = write_diagnosis(config, lambda share, what: None)
    assert (tmp_path / "out" / "figures" / "paths_1.png").exists()
    improved = read_robot(tmp_path / "out" / "improved_robot.toml").parameters
    assert abs(improved.gyro.scale - 0.02) < 5 * improved.gyro.scale_std
    drive_part = result.diagnosis.to_json()["drive"]
    (error,) = drive_part["position_error"]
    assert error["after_rms_m"] < 0.5 * error["before_rms_m"]
    assert "data set" not in (tmp_path / "out" / "diagnosis.html").read_text().split("<h2>Tables")[0]


def test_several_recordings_need_a_robot(tmp_path: Path) -> None:
    from gyrocal.commands.diagnose import DiagnoseConfig, write_diagnosis

    config = DiagnoseConfig(tmp_path / "a", tmp_path / "out", others=(tmp_path / "b",))
    with pytest.raises(InputError, match="--robot"):
        write_diagnosis(config, lambda share, what: None)


def test_a_rival_is_said_to_be_less_likely_or_likelier() -> None:
    said = [_other(Alternative("gyro_bias", ratio)) for ratio in (9.0, 2.0, 0.005, 1e-21)]
    assert said == [
        "gyro_bias (9 to 1 against it)",
        "gyro_bias (about as well)",
        "gyro_bias (likelier: 200 to 1 for it)",
        "gyro_bias (likelier: more than 1,000,000 to 1 for it)",
    ]


def test_what_a_plus_minus_is_stands_in_the_answer_once(late: DriveDiagnosis) -> None:
    """Beside intervals of 95 % nothing had said that it is one standard deviation."""
    lines = drive_sentences(late)
    saying = [k for k, line in enumerate(lines) if "one standard deviation" in line]
    assert saying == [next(k for k, line in enumerate(lines) if "±" in line)]


def test_a_robot_file_that_says_nothing_grants_nothing(tmp_path: Path) -> None:
    """A gyro bias was told to lie within what the file grants, where a default of 0.2 deg/s was meant."""
    path = tmp_path / "robot.toml"
    keys = ("gyro_bias_dps", "gyro_scale", "wheel_separation_m", "left_scale", "right_scale")
    for given, says in (
        ((), "what is usual where the robot file says nothing"),
        (keys[:1], "what the robot file grants, or what is usual where it says nothing"),
        (keys, "what the robot file grants"),
    ):
        stds = "".join(f"{key} = 0.01\n" for key in given)
        path.write_text(f"wheel_separation_m = 0.5\nstatic_s = 0.0\n[initial_std]\n{stds}")
        robot = read_robot(path)
        assert _granted(robot) == says
        as_much = _bias_granted(robot)
        default = f"{robot.initial_std['gyro_bias_dps']:g} deg/s is taken"
        assert as_much.endswith(default) == (not given)
        assert (as_much == "the robot file grants as much") == bool(given)
