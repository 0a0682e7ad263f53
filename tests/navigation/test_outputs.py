"""Files and page of a replay, and the figures that stand in them."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from gyrocal.navigation.replay import LogReplay, replay_log
from gyrocal.navigation.table import make_table, table_of
from gyrocal.navigation.track import CONDITIONS
from gyrocal.report import navigation as module
from gyrocal.report.navigation import replay_files, shown, verdict
from gyrocal.report.navigation_figures import (
    bars_caption,
    draw_bars,
    draw_errors,
    draw_innovations,
    draw_states,
    draw_trajectories,
)
from tests.navigation.drives import both_ways, calibration, drive, robot, source


@pytest.fixture(scope="module")
def replays() -> list[LogReplay]:
    """One log each way, in four conditions."""
    names = ("cw1", "ccw1")
    return [
        replay_log(source(log, name=n), robot(), calibration())
        for n, log in zip(names, both_ways(), strict=True)
    ]


def test_files_and_summary(replays: list[LogReplay], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "render", lambda figure, kind: b"picture")
    said: list[float] = []
    result = replay_files(replays, robot(), calibration(), lambda share, what: said.append(share))
    assert said == sorted(said)
    names = set(result.files)
    assert {"trajectories/cw1.csv", "states/ccw1_uncalibrated_filter.csv", "figures/table.svg"} <= names
    summary = json.loads(result.files["summary.json"])
    log = summary["logs"][0]
    assert len(log["observability"]["calibrated_filter"]["directions"]) == 4
    assert log["filter"]["calibrated_filter"]["consistent"]
    assert log["conditions"]["calibrated"]["position_error_m"]["return"] < 0.5
    assert log["conditions"]["calibrated_filter"]["estimates"]["heading_deg"]["sigma"] > 0
    assert summary["robot"]["defaults_used"] == []
    header, *rows = result.files["trajectories/cw1.csv"].decode().splitlines()
    assert header.startswith("t_s,truth_x_m,truth_y_m,truth_heading_deg,uncalibrated_x_m")
    assert len(rows) == len(drive())
    last = dict(zip(header.split(","), map(float, rows[-1].split(",")), strict=True))
    end_m = np.hypot(last["calibrated_x_m"] - last["truth_x_m"], last["calibrated_y_m"] - last["truth_y_m"])
    assert end_m == pytest.approx(log["conditions"]["calibrated"]["position_error_m"]["end"], abs=2e-4)
    page = result.files["replay.html"].decode()
    assert any(r.startswith("Calibration of KVH") for r in result.remarks)
    assert "Table II of these runs" in page
    assert "calibration, filter: The log sees" in page


def test_the_verdict_says_sizes_and_factors(replays: list[LogReplay]) -> None:
    text = verdict(replays, make_table(replays))
    assert text.startswith("The filter is consistent")
    assert " Mean return position error of 2 logs: " in text
    assert "cm (calibration, filter)" in text
    assert "by both." in text


def test_a_factor_that_the_rms_denies_is_none(replays: list[LogReplay]) -> None:
    """An end point may be luck: "4.03 by filter" had been the headline of a path that got worse."""
    table = make_table(replays)
    assert set(table.rms_factors) == {"filter", "calibration", "both"}
    mean = replace(table.means[-1], direction="all")
    ends = {"filter": 4.03, "calibration": 2.0, "both": 3.0}
    told = replace(
        table, means=(mean,), factors={"all": ends}, rms_factors={**ends, "filter": 0.84, "both": 2.5}
    )
    assert verdict(replays, told).endswith(
        "Improvement factors: none that holds by filter (4.03 at the end, 0.84 in rms along the path), 2 at the end, 2 in rms "
        "along the path by calibration, 3 at the end, 2.5 in rms along the path by both."
    )
    assert verdict(replays, replace(told, rms_factors={})).endswith(
        "4.03 by filter, 2 by calibration, 3 by both."
    )


def test_bars_stand_on_zero_and_a_logarithmic_axis_has_dots(replays: list[LogReplay]) -> None:
    table = make_table(replays)
    spread = {c.id: 10.0 ** (-k) for k, c in enumerate(CONDITIONS)}
    near = {c.id: 1.0 + 0.1 * k for k, c in enumerate(CONDITIONS)}
    rows = [replace(r, errors_m=near) for r in table.rows]
    bars = draw_bars(table_of(rows, "return")).axes
    assert [(a.get_yscale(), len(a.patches), a.get_ylim()[0]) for a in bars] == [("linear", 4, 0.0)] * 2
    assert bars_caption(table_of(rows, "return")) == ""
    wide = table_of([replace(r, errors_m=spread) for r in [*rows, *rows]], "return")
    dots = draw_bars(wide).axes
    assert [(a.get_yscale(), len(a.patches), len(a.lines)) for a in dots] == [("log", 0, 8)] * 2
    assert bars_caption(wide) == ", on a logarithmic axis; dashed: mean of the block"


def test_figures_show_what_they_say(replays: list[LogReplay]) -> None:
    assert [r.name for r in shown([*replays, *replays])] == ["cw1", "ccw1"]
    trajectories = draw_trajectories(replays, make_table(replays))
    assert len(trajectories.axes) == 4
    errors = draw_errors(replays[0])
    assert [axes.get_ylabel() for axes in errors.axes if axes.get_ylabel()] == [
        "heading error, deg",
        "position error, m",
    ]
    assert len(draw_innovations(replays[0]).axes) == 2
    states = draw_states(replays[0])
    # Turns alone cannot tell the gyro's scale from the track: the model leaves it alone.
    assert [len(axes.lines) for axes in states.axes] == [2, 2, 2, 2]


def test_a_caption_says_that_fitted_errors_are_of_another_frame(replays: list[LogReplay]) -> None:
    fitted = replay_log(source(drive(), name="fitted"), robot(), method="positions")
    for replay, said in ((replays[0], False), (fitted, True)):
        figures = module.draw_figures([replay], make_table([replay]))
        (caption,) = [p.caption for p, _ in figures if p.name.startswith("errors_")]
        assert ("not of the same frame" in caption) == said


def test_of_headings_alone_the_page_tells_the_error_of_the_heading(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "render", lambda figure, kind: b"picture")
    log = drive()
    nothing = np.full(len(log), np.nan)
    replays = [replay_log(source(replace(log, truth_x_m=nothing, truth_y_m=nothing)), robot())]
    result = replay_files(replays, robot(), None, lambda share, what: None)
    condition = json.loads(result.files["summary.json"])["logs"][0]["conditions"]["uncalibrated"]
    assert "position_error_m" not in condition
    assert condition["heading_error_deg"]["rms"] > 0
    rms = f"{condition['heading_error_deg']['rms']:.2g} deg (no calibration, no filter)"
    assert f"Mean rms error of the heading, against truth: {rms}" in result.verdict
    (axes, *_) = draw_errors(replays[0]).axes
    assert axes.get_ylabel() == "heading error, deg"
    assert len(draw_errors(replays[0]).axes) == 2
    ((_, *cells, _),) = [row for row in result.errors.rows if row[0].endswith("no calibration, no filter")]
    assert cells[:3] == ["-"] * 3
