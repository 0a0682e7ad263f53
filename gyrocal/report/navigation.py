"""What `gyrocal replay` writes: trajectories, states, the table, figures, and one page that holds them all."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import gyrocal
from gyrocal.fusion import STATES, Coefficients
from gyrocal.navigation.align import METHODS
from gyrocal.navigation.judge import MOST_APART, Judgement
from gyrocal.navigation.replay import LogReplay
from gyrocal.navigation.table import HEADINGS, MEASURES, Table, make_table
from gyrocal.navigation.track import CONDITIONS, Track
from gyrocal.navigation.yaw import compare_yaw
from gyrocal.records.csvio import Floats, format_columns
from gyrocal.records.files import finite
from gyrocal.records.robot import Robot
from gyrocal.report.navigation_figures import (
    bars_caption,
    draw_bars,
    draw_errors,
    draw_innovations,
    draw_states,
    draw_trajectories,
    estimated,
    in_truth_frame,
)
from gyrocal.report.page import Page, Picture, render_page
from gyrocal.report.page import Table as PageTable
from gyrocal.report.style import render
from gyrocal.units import plural

#: Schema of summary.json.
SCHEMA = "gyrocal-replay/1"

Report = Callable[[float, str], None]


@dataclass(frozen=True)
class ReplayResult:
    """Tables and summary, as printed; everything is in `files` too, by path below the output directory."""

    verdict: str
    table: Table
    errors: PageTable
    summary: Mapping[str, Any]
    remarks: tuple[str, ...]
    files: Mapping[str, bytes]


def replay_files(
    replays: Sequence[LogReplay], robot: Robot, coefficients: Coefficients | None, report: Report
) -> ReplayResult:
    """Everything that is written, from replayed logs; the same logs give the same bytes."""
    table = make_table(replays)
    remarks = _remarks(replays, robot, coefficients)
    summary = {
        "schema": SCHEMA,
        "software": f"gyrocal {gyrocal.__version__}",
        "robot": {"wheel_separation_m": robot.wheel_separation_m, "static_s": robot.static_s}
        | {"initial_std": dict(robot.initial_std), "noise": dict(robot.noise)}
        | {"defaults_used": list(robot.defaulted)},
        "coefficients": dict(coefficients.sensor) if coefficients else None,
        "table": table.to_json(),
        "logs": [_log_summary(r, robot) for r in replays],
        "remarks": list(remarks),
    }
    files: dict[str, bytes] = {"table.csv": table.csv().encode()}
    files["summary.json"] = (json.dumps(_plain(summary), indent=1, allow_nan=False) + "\n").encode()
    for replay in replays:
        files[f"trajectories/{replay.name}.csv"] = _trajectories_csv(replay).encode()
        for track in replay.tracks:
            if track.condition.filtering:
                name = f"states/{replay.name}_{track.condition.id}.csv"
                files[name] = _states_csv(replay, track).encode()
    pictures = []
    figures = draw_figures(replays, table)
    for k, (picture, figure) in enumerate(figures):
        report(0.7 + 0.3 * k / len(figures), f"draw {picture.name}")
        png = render(figure, "png")
        files[f"figures/{picture.name}.png"] = png
        files[f"figures/{picture.name}.svg"] = render(figure, "svg")
        pictures.append(replace(picture, png=png))
    files["replay.html"] = render_page(_page(replays, table, remarks, pictures, robot, coefficients)).encode()
    return ReplayResult(verdict(replays, table), table, _errors_table(replays), summary, remarks, files)


def _plain(value: Any) -> Any:
    """Strict JSON: NaN and infinity become null, arrays lists."""
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def _remarks(
    replays: Sequence[LogReplay], robot: Robot, coefficients: Coefficients | None
) -> tuple[str, ...]:
    found: list[str] = []
    methods = {t.alignment.method for r in replays for t in r.tracks if t.alignment}
    found += [f"Alignment with truth by {METHODS[m]}." for m in sorted(methods)]
    if coefficients is None:
        found.append("No coefficient file was given: only the conditions without calibration.")
    else:
        found.append(
            f"Calibration of {_sensor(coefficients)}; a log does not say which gyro it is of, so see that it is this one."
        )
    estimated = replays[0].kind == "model"
    defaults = [d for d in robot.defaulted if not (estimated and d.startswith("noise."))]
    if defaults:
        found.append("The robot file does not give, and defaults stand for: " + ", ".join(defaults) + ".")
    if estimated:
        found.append(
            "Noise figures are estimated on each log, from the robot file's where it has them: summary.json tells them."
        )
    for replay in replays if len(replays) <= 3 else ():
        if not replay.survey.speed_only:
            yaw = compare_yaw(replay.survey, robot.wheel_separation_m)
            found.append(f"{replay.name}: {yaw.sentence(-robot.parameters.gyro.delay_s)}.")
        labels: dict[str, list[str]] = {}
        for condition, seen in replay.observability.items():
            label = next(c.label for c in CONDITIONS if c.id == condition)
            labels.setdefault(" ".join(seen.sentences()), []).append(label)
        found += [f"{replay.name}, {'; '.join(names)}: {text}" for text, names in labels.items()]
    said: dict[str, list[str]] = {}
    for replay in replays:
        for note in replay.notes:
            said.setdefault(note, []).append(replay.name)
    for note, names in said.items():
        found.append(
            f"{note} ({', '.join(names) if len(names) < len(replays) or len(names) == 1 else 'all logs'})."
        )
    return tuple(found)


def _sensor(coefficients: Coefficients) -> str:
    """Model and serial number of the calibrated gyro, as far as the file knows them."""
    known = (str(coefficients.sensor.get(key) or f"unknown {key}") for key in ("model", "serial"))
    return ", ".join(known)


def _log_summary(replay: LogReplay, robot: Robot) -> dict[str, Any]:
    found = replay.survey
    return {
        "log": replay.name,
        "direction": replay.direction,
        "rows": found.rows,
        "duration_s": found.duration_s,
        "distance_m": found.distance_m,
        "truth_rows": found.truth_rows,
        "yaw": None if found.speed_only else compare_yaw(found, robot.wheel_separation_m).to_json(),
        "observability": {k: v.to_json() for k, v in replay.observability.items()},
        "conditions": {t.condition.id: _track_summary(t, robot) for t in replay.tracks},
        "filter": {k: _judged(v) for k, v in replay.judgements.items()},
        "notes": list(replay.notes),
    }


def _judged(judgement: Judgement) -> dict[str, Any]:
    found: dict[str, Any] = finite(asdict(judgement))
    white: dict[str, Any] = found.pop("whiteness")
    return white | found


def _track_summary(track: Track, robot: Robot) -> dict[str, Any]:
    result: dict[str, Any] = {
        "static_bias_dps": track.bias.bias_dps if track.bias else None,
        "static_bias_sigma_dps": track.bias.std_error_dps if track.bias else None,
        "counts": {k: v for k, v in vars(track.counts).items() if v},
    }
    if track.errors:
        e = track.errors
        result["position_error_m"] = {"rms": e.rms_m, "max": e.max_m, "end": e.end_m, "return": e.return_m}
        result["position_error_m"]["truth_rows"] = e.rows
    if track.heading_errors:
        h = track.heading_errors
        result["heading_error_deg"] = {"rms": h.rms_deg, "max": h.max_deg, "end": h.end_deg}
        result["heading_error_deg"]["truth_rows"] = h.rows
    if track.alignment:
        a = track.alignment
        result["alignment"] = {"method": METHODS[a.method], "rotation_deg": a.rotation_deg}
        result["alignment"] |= {"x_m": a.x_m, "y_m": a.y_m, "sigma": list(a.sigma)}
    if track.condition.filtering:
        result["nis"] = {
            "mean": track.whiteness.nis,
            "rows": track.nis_rows,
            "lag1": track.whiteness.lag1,
            "slow": finite(track.whiteness.slow),
        }
        result["noise"] = asdict(track.robot.noise)
        result["estimates"] = {
            name: {"value": float(track.states[-1, k]), "sigma": float(track.std[-1, k])}
            for k, name in enumerate(STATES)
        }
    return result


def _trajectories_csv(replay: LogReplay) -> str:
    columns: dict[str, tuple[Floats, str]] = {"t_s": (replay.t_s, "%.4f")}
    if np.isfinite(replay.truth).any():
        for k, name in enumerate(("truth_x_m", "truth_y_m", "truth_heading_deg")):
            columns[name] = (replay.truth[:, k], "%.4f")
    for track in replay.tracks:
        x, y = in_truth_frame(track)
        rotation = track.alignment.rotation_deg if track.alignment else 0.0
        columns[f"{track.condition.id}_x_m"] = (x, "%.4f")
        columns[f"{track.condition.id}_y_m"] = (y, "%.4f")
        columns[f"{track.condition.id}_heading_deg"] = (track.heading_deg + rotation, "%.4f")
    return format_columns(columns)


def _states_csv(replay: LogReplay, track: Track) -> str:
    columns: dict[str, tuple[Floats, str]] = {"t_s": (replay.t_s, "%.4f")}
    for k, name in enumerate(STATES):
        columns[name] = (track.states[:, k], "%.8g")
        columns[f"{name}_sigma"] = (track.std[:, k], "%.6g")
    columns["innovation_deg"] = (track.innovation_deg, "%.6g")
    columns["innovation_sigma_deg"] = (track.innovation_sigma_deg, "%.6g")
    return format_columns(columns)


def shown(replays: Sequence[LogReplay]) -> list[LogReplay]:
    """Logs whose errors and states are drawn: the first of each direction."""
    return list({r.direction: r for r in reversed(replays)}.values())[::-1]


def draw_figures(replays: Sequence[LogReplay], table: Table) -> list[tuple[Picture, Figure]]:
    """Every figure of the page, with its caption."""
    result = [
        (
            Picture(
                "trajectories",
                "Trajectories of all runs",
                "Dead reckoning in each condition (the paper's figure 4), over the truth where there is one. Dots: end of each run.",
            ),
            draw_trajectories(replays, table),
        )
    ]
    if table.measure != "none":
        caption = f"{MEASURES[table.measure].capitalize()} of every run{bars_caption(table)}."
        result.append((Picture("table", "Errors of all runs", caption), draw_bars(table)))
    for replay in shown(replays):
        name = replay.name
        if any(t.alignment for t in replay.tracks):
            caption = "Error against truth. Grey: two standard deviations, as the filter itself states them from its start."
            if any(t.alignment and t.alignment.method == "positions" for t in replay.tracks):
                caption += " The error is what the fit of rotation and shift to the truth leaves: not of the same frame."
            result.append((Picture(f"errors_{name}", f"Errors of {name}", caption), draw_errors(replay)))
        if not any(track.condition.filtering for track in replay.tracks):
            continue
        caption = (
            "Encoder heading minus gyro heading before each update (eq. 13); black: two standard deviations."
        )
        result.append(
            (Picture(f"innovations_{name}", f"Innovations of {name}", caption), draw_innovations(replay))
        )
        if not estimated(replay):
            continue
        caption = (
            "Constants that the filter estimates, with two standard deviations. A band as wide at the end as at the "
            "start has learnt nothing: what a log cannot tell stays at its prior."
        )
        result.append((Picture(f"states_{name}", f"States of {name}", caption), draw_states(replay)))
    return result


def _length(value_m: float) -> str:
    return f"{value_m:.2f} m" if value_m >= 1.0 else f"{100.0 * value_m:.1f} cm"


def verdict(replays: Sequence[LogReplay], table: Table) -> str:
    """The result in words: first whether the filter holds and pays, then the table's means."""
    mean, count = table.means[-1].errors_m, len(table.rows)
    if table.measure == "none":
        return f"{filter_sentence(replays)} {count} {plural(count, '[log|logs]')} replayed; {MEASURES['none']}.{_heading_sentence(replays)}"
    sizes = [f"{_length(mean[c.id])} ({c.label})" for c in CONDITIONS if not math.isnan(mean[c.id])]
    text = f"{filter_sentence(replays)} Mean {MEASURES[table.measure]} of {count} {plural(count, '[log|logs]')}: {', '.join(sizes)}."
    factors = [_factor(table, name, end) for name, end in table.factors[table.means[-1].direction].items()]
    said = [factor for factor in factors if factor]
    return text + (f" Improvement factors: {', '.join(said)}." if said else "")


def _factor(table: Table, name: str, end: float) -> str:
    """A factor of the end, and beside it that of the rms along the path, which may deny it."""
    rms = table.rms_factors.get(name, math.nan)
    if math.isnan(end):
        return ""
    if math.isnan(rms):
        return f"{end:.3g} by {name}"
    both = f"{end:.3g} at the end, {rms:.3g} in rms along the path"
    # Where one grows and the other shrinks, the end was good or bad luck.
    agreed = (end - 1.0) * (rms - 1.0) >= 0.0
    return f"{both} by {name}" if agreed else f"none that holds by {name} ({both})"


def _heading_sentence(replays: Sequence[LogReplay]) -> str:
    """Errors of the headings, where they are all that the truth tells."""
    said = []
    for condition in CONDITIONS:
        tracks = [t for r in replays if (t := r.track(condition.id)) is not None]
        errors = [t.heading_errors.rms_deg for t in tracks if t.heading_errors]
        if errors:
            said.append(f"{float(np.mean(errors)):.2g} deg ({condition.label})")
    return f" Mean rms error of the heading, against truth: {', '.join(said)}." if said else ""


def filter_sentence(replays: Sequence[LogReplay]) -> str:
    """Whether the filter describes the logs, and whether it beats the gyro alone, by rms and by end."""
    if not all(r.judgements for r in replays):
        return "A log without turns by its wheels has no filter: heading by the gyro."
    ids = {c.id: c for c in CONDITIONS if c.filtering}
    last = [list(r.judgements)[-1] for r in replays]  # with calibration where there is one
    pairs = [
        (
            r.track(
                next(c.id for c in CONDITIONS if (c.calibrated, c.filtering) == (ids[k].calibrated, False))
            ),
            r.track(k),
        )
        for r, k in zip(replays, last, strict=True)
    ]
    judged = [r.judgements[k] for r, k in zip(replays, last, strict=True)]
    holding = sum(j.consistent for j in judged)
    nis, lag1, slow = (
        float(np.median([getattr(j.whiteness, name) for j in judged])) for name in ("nis", "lag1", "slow")
    )
    many = len(replays) > 1
    which = f" on {holding} of {len(replays)} logs" if many and 0 < holding < len(replays) else ""
    state = "is consistent" if holding else "is not consistent"
    apart = float(np.median([j.apart for j in judged]))
    moved = (
        f", path moved {apart:.1f} times as far as it says"
        if apart < math.inf
        else ", path moved where it says that it takes nothing off"
    )
    of_path = moved if not holding and apart > MOST_APART else ""
    of_sums = f", NIS of sums {slow:.2f}" if math.isfinite(slow) else ""
    text = f"The filter {state}{which} (NIS {nis:.2f}, lag-1 correlation {lag1:.2f}{of_sums}{of_path}{', medians' if many else ''})"
    left = sum(j.left_to_gyro for j in judged) if replays[0].kind == "model" else 0
    if left == len(replays):
        return f"{text} and is left to the gyro{', which it does not promise to better here' if holding else ''}."
    part = f" (on {left} of {len(replays)} logs it is left to the gyro)" if left else ""
    errors = [(a.errors, b.errors) for a, b in pairs if a and b and a.errors and b.errors and a.errors.rows]
    if not errors:
        return f"{text}{part}; without truth nobody knows whether it beats the gyro alone."
    said = []
    for name, what in (("rms_m", "rms"), ("end_m", "end")):
        gyro, filtered = (float(np.mean([getattr(pair[k], name) for pair in errors])) for k in (0, 1))
        lengths = _length(filtered), _length(gyro)
        # What the figures printed do not tell apart is no win.
        verb = "equals" if lengths[0] == lengths[1] else "beats" if filtered < gyro else "loses to"
        said.append(f"{verb} the gyro alone by {what} ({lengths[0]} against {lengths[1]})")
    return f"{text}{part}; it {' and '.join(said)}."


def _page(
    replays: Sequence[LogReplay],
    table: Table,
    remarks: Sequence[str],
    pictures: Sequence[Picture],
    robot: Robot,
    coefficients: Coefficients | None,
) -> Page:
    mean = table.means[-1].errors_m
    key = [(c.label, "-" if math.isnan(mean[c.id]) else _length(mean[c.id])) for c in CONDITIONS]
    tables = [
        PageTable(
            "table", "Table II of these runs", HEADINGS, table.lines(), table.csv(), MEASURES[table.measure]
        ),
        _errors_table(replays),
        _estimates_table(replays),
    ]
    provenance = {
        "software": f"gyrocal {gyrocal.__version__}",
        "logs": ", ".join(r.name for r in replays),
        "robot file": robot.source.name,
        "calibration": _sensor(coefficients) if coefficients else "none",
    }
    return Page("Dead reckoning", verdict(replays, table), key, remarks, pictures, tables, provenance)


def _errors_table(replays: Sequence[LogReplay]) -> PageTable:
    columns = ("run, condition", "rms, m", "max, m", "end, m", "heading rms, deg", "rotation to truth, deg")
    rows = []
    for replay in replays:
        for track in replay.tracks:
            if track.alignment is None:
                continue
            e, h, a = track.errors, track.heading_errors, track.alignment
            rotation = f"{a.rotation_deg:.2f}" + (f" ± {a.sigma[0]:.2f}" if a.sigma[0] else "")
            known = [math.nan] * 3 if e is None else [e.rms_m, e.max_m, e.end_m]
            known.append(h.rms_deg if h else math.nan)
            cells = (*("-" if math.isnan(v) else f"{v:.3f}" for v in known), rotation)
            rows.append((f"{replay.name}, {track.condition.label}", *cells))
    csv = "\n".join(",".join(f'"{cell}"' for cell in row) for row in (columns, *rows)) + "\n"
    return PageTable("errors", "Errors against truth, all along the path", columns, rows, csv)


def _estimates_table(replays: Sequence[LogReplay]) -> PageTable:
    columns = ("run, condition", *(STATES[k] for k in (3, 4, 5, 7, 8)))
    rows = []
    for replay in replays:
        for track in replay.tracks:
            if track.condition.filtering:
                cells = [f"{track.states[-1, k]:.2g} ± {track.std[-1, k]:.1g}" for k in (3, 4, 5, 7, 8)]
                rows.append((f"{replay.name}, {track.condition.label}", *cells))
    csv = "\n".join(",".join(f'"{cell}"' for cell in row) for row in (columns, *rows)) + "\n"
    return PageTable("estimates", "What the filter estimated (± one sigma)", columns, rows, csv)
