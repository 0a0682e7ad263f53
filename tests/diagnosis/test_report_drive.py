"""Pictures of a drive's diagnosis: every law on its own coordinate, every point with its bar, before beside after."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure

from gyrocal.diagnosis.drive_result import DriveDiagnosis, diagnose_drive
from gyrocal.records.robot import read_robot
from gyrocal.report import style
from gyrocal.report.diagnosis import tables
from gyrocal.report.diagnosis_drive import drive_figures
from tests.diagnosis.drive_world import SEPARATION_M, Hidden, simulate


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory) -> DriveDiagnosis:
    """Encoders and gyro 0.3 s apart."""
    path = tmp_path_factory.mktemp("robot") / "robot.toml"
    path.write_text(f"wheel_separation_m = {SEPARATION_M}\nstatic_s = 0.0\n")
    return diagnose_drive("drive.csv", simulate(Hidden(delay_s=0.3), 11), read_robot(path))


@pytest.fixture(scope="module")
def drawn(late: DriveDiagnosis) -> dict[str, Figure]:
    return {p.name: figure for p, figure in drive_figures(late) if figure is not None}


def _points(figure: Figure, panel: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Places and heights of each set of points with error bars."""
    containers = [c for c in figure.axes[panel].containers if isinstance(c, ErrorbarContainer)]
    return [(np.asarray(c[0].get_xdata()), np.asarray(c[0].get_ydata())) for c in containers]


def test_delay_is_drawn_over_the_change_of_the_turn_rate(drawn: dict[str, Figure]) -> None:
    """Before, the difference is the delay times the turn acceleration; after, nothing of it is left."""
    figure = drawn["effect_gyro_delay"]
    assert "Change of the turn rate" in figure.axes[0].get_xlabel()
    slopes = []
    for panel in (0, 1):
        ((x, y),) = _points(figure, panel)
        slopes.append(float(x @ y / (x @ x)))
    assert slopes == pytest.approx([0.3, 0.0], abs=0.05)


def test_turns_show_before_and_after(drawn: dict[str, Figure]) -> None:
    before, after = drawn["turns"].axes
    spread = []
    for panel in (before, after):
        gyro, encoder = (np.asarray(v) for v in panel.lines[1].get_data())
        spread.append(float(np.std(encoder - gyro)))
    assert spread[1] < 0.5 * spread[0]
    assert [panel.get_title(loc="left") for panel in (before, after)] == [
        "Nominal model",
        "With the named physics",
    ]


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
    for name in ("difference", "effect_gyro_delay"):
        first, second = once[name], again[name]
        assert first is not None
        assert second is not None
        assert style.render(first, "png") == style.render(second, "png")


def test_slips_are_marked_and_left_out_of_the_means(late: DriveDiagnosis) -> None:
    after = late.fit.after_deg.copy()
    after[7] = 50.0
    noise = replace(late.fit.noise, slips=np.array([7]), slip_deg=np.array([50.0]))
    slipped = replace(late, fit=replace(late.fit, after_deg=after, noise=noise))
    figures = {p.name: figure for p, figure in drive_figures(slipped) if figure is not None}
    legend = figures["difference"].axes[0].get_legend()
    assert legend is not None
    assert "slip, left out of the fit" in [text.get_text() for text in legend.get_texts()]
    assert max(np.max(np.abs(y)) for _, y in _points(figures["coordinates"], 0)) < 10


def test_table_of_a_drive_counts_blocks_from_the_nominal_model(late: DriveDiagnosis) -> None:
    table = next(
        t for t in tables(replace(late.diagnosis, counted_in="block of 10 s")) if t.name == "improvement"
    )
    assert table.columns[7] == "Log-loss gain, nats a block of 10 s"
    assert [row[:2] for row in table.rows] == [("gyro_delay", "nominal model")]


def test_drive_command_counts_in_blocks(tmp_path: Path) -> None:
    """What the command writes for a short log; nothing of it speaks of data sets."""
    from gyrocal.report.diagnosis_build import DiagnoseConfig, write_diagnosis

    log = simulate(Hidden(delay_s=0.3), 11)
    columns = (log.t_s, log.left_m, log.right_m, log.gyro_dps)
    rows = "\n".join(",".join(f"{value:.7f}" for value in row) + "," for row in zip(*columns, strict=True))
    (tmp_path / "drive.csv").write_text("t_s,left_m,right_m,gyro_dps,gyro_temp_c\n" + rows + "\n")
    (tmp_path / "robot.toml").write_text(f"wheel_separation_m = {SEPARATION_M}\nstatic_s = 0.0\n")
    config = DiagnoseConfig(tmp_path / "drive.csv", tmp_path / "out", robot=tmp_path / "robot.toml")
    result = write_diagnosis(config, lambda share, what: None)
    assert result.diagnosis.counted_in == "block of 10 s"
    page = (tmp_path / "out" / "diagnosis.html").read_text()
    assert "data set" not in page.split("<h2>Tables")[0]
    assert (tmp_path / "out" / "figures" / "effect_gyro_delay.png").exists()
