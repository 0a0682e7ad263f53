"""A run of `gyrocal acquire` against strange devices, and what of its record departs from what was true."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tests.bench.strangers.chambers import ASCII_CHAMBERS, ChamberDevice
from tests.bench.strangers.gyros import GYROS, Gyro
from tests.bench.strangers.lab import TICK_S, Lab, Moment
from tests.bench.strangers.modbus import MODBUS_CHAMBERS, ModbusChamber
from tests.bench.strangers.tables import TABLES, TableDevice

CHAMBERS: dict[str, type[ChamberDevice]] = {**ASCII_CHAMBERS, **MODBUS_CHAMBERS}
Floats = NDArray[np.float64]

SAFE_C = 23.0
#: Bytes that a loaded machine passes on late are stamped late; a driver that were wrong would be wrong by more.
ARRIVAL_S = 0.5


@dataclass
class Bench:
    """Three strange devices in one lab."""

    lab: Lab
    gyro: Gyro
    table: TableDevice
    chamber: ChamberDevice


@contextmanager
def bench(gyro: str, table: str, chamber: str, *, tcp: bool = False, seed: int = 1) -> Iterator[Bench]:
    """The devices of three kinds, running."""
    with Lab(seed) as lab:
        devices = Bench(lab, GYROS[gyro](lab, tcp=tcp), TABLES[table](lab, tcp=tcp), CHAMBERS[chamber](lab))
        try:
            yield devices
        finally:
            if isinstance(devices.chamber, ModbusChamber):
                devices.chamber.close()


def profile(
    b: Bench,
    *,
    ports: Mapping[str, str] | None = None,
    rates: str = "[10.0, 40.0]",
    temperatures: str = "[24.0, 26.0]",
    dwell_s: float = 1.0,
    rests: bool = True,
) -> str:
    """A small plan for these devices: rest and some rates of both signs; the table begins with the fastest."""
    urls = {"gyro": b.gyro.line.url, "table": b.table.line.url, "chamber": b.chamber.url} | dict(ports or {})
    lines = [
        'title = "A small run against strangers"',
        f'[sensor]\nmodel = "stranger"\nsample_rate_hz = {b.gyro.rate_hz}\nrate_range_dps = [-100.0, 100.0]',
        "temp_range_c = [-40.0, 75.0]\non_before_s = 3600.0",
        "[bench]\nlatitude_deg = 42.3",
    ]
    for name, device in (("gyro", b.gyro), ("table", b.table), ("chamber", b.chamber)):
        options = dict(type(device).options)
        if name == "gyro" and b.gyro.kind.startswith("kvh-frame"):
            options["data_rate_hz"] = b.gyro.rate_hz
        lines.append(f'[{name}]\ndevice = "{device.kind}:{urls[name]}"')
        if name == "chamber" and not b.chamber.takes_alarms:
            lines.append("own_alarms_set = true")
        if options:
            lines.append(f"[{name}.options]")
            lines += [f"{key} = {json.dumps(value)}" for key, value in options.items()]
    lines += [
        "[limits]\nmax_rate_dps = 60.0\nmin_temp_c = 0.0\nmax_temp_c = 50.0\nmax_ramp_c_per_min = 30.0",
        f"[plan]\ntemperatures_c = {temperatures}\ntemperature_order = 'listed'\nrates_dps = {rates}",
        "both_signs = true\nrate_order = 'shuffled'\nseed = 1",
        f"zero_first_and_last = {str(rests).lower()}",
        f"dwell_s = {dwell_s}",
        "[settle]\ntolerance_dps = 0.1\nhold_s = 0.3\ndeadline_s = 10.0\non_deadline = 'unsettled'",
        "[ramp]\nrate_c_per_min = 30.0\ndeadline_s = 60.0",
        "[soak]\nwindow_c = 0.5\ntime_s = 2.0\nslope_c_per_min = 3.0\nslope_over_s = 10.0\nexpected_s = 3.0",
        "deadline_s = 60.0\non_deadline = 'unsettled'",
        "[record]\naveraging_s = 0.5\nbench_period_s = 0.2",
        f"[safe]\nchamber_c = {SAFE_C}",
        "[retry]\nattempts = 2\nwait_s = 5.0",
        # Tests share their machine with others; every sample is compared here with what was sent.
        "[stream]\nclump_share = 1.0\nmissing_share = 0.5\nsurplus_share = 1.0\ngap_share = 0.5",
    ]
    return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class Outcome:
    """How `acquire` ended, and where."""

    code: int
    said: str
    run: Path


def until(what: Callable[[], bool], within_s: float = 60.0) -> None:
    """Wait for something to come true."""
    end_s = time.monotonic() + within_s
    while not what():
        if time.monotonic() > end_s:
            raise AssertionError(f"did not come true within {within_s:g} s")
        time.sleep(0.01)


def start(tmp_path: Path, text: str) -> tuple[subprocess.Popen[str], Path]:
    """Begin `gyrocal acquire` with a profile of this text."""
    file, run = tmp_path / "profile.toml", tmp_path / "run"
    file.write_text(text)
    command = [sys.executable, "-m", "gyrocal", "acquire", str(file), "--out", str(run)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    return process, run


def acquire(tmp_path: Path, text: str, *, within_s: float = 120.0) -> Outcome:
    """A whole run; it is ended, and the test with it, when it takes too long."""
    process, run = start(tmp_path, text)
    return finish(process, run, within_s=within_s)


def finish(process: subprocess.Popen[str], run: Path, *, within_s: float = 60.0) -> Outcome:
    """The end of a run that was begun; it is killed, and the test fails, when it takes too long."""
    try:
        said, _ = process.communicate(timeout=within_s)
    except subprocess.TimeoutExpired:
        process.kill()
        said, _ = process.communicate()
        raise AssertionError(f"acquire did not end within {within_s:g} s; it said: {said}") from None
    return Outcome(process.returncode, said, run)


def journal(run: Path) -> list[dict[str, object]]:
    """Events of a run."""
    return [json.loads(line) for line in (run / "journal.jsonl").read_text().splitlines()]


def differences(b: Bench, outcome: Outcome) -> list[str]:
    """Where the record of a whole run departs from what was true; empty is what is wanted."""
    found: list[str] = []
    if not (outcome.run / "journal.jsonl").exists():
        return [f"exit code {outcome.code}, and no journal: {outcome.said[-400:]}"]
    segments = [e for e in journal(outcome.run) if e["event"] == "segment"]
    if outcome.code != 0:
        found.append(f"exit code {outcome.code}: {outcome.said[-400:]}")
    if not segments:
        return [*found, "no segment was recorded"]
    bad = [f"{e['file']}: {e['outcome']}" for e in segments if e["outcome"] != "ok"]
    frames = {str(e["file"]): pd.read_csv(outcome.run / str(e["file"])) for e in segments}
    whole = [frames[str(e["file"])] for e in segments if e["averaging_s"] is None]
    offsets = [offset for frame in whole if (offset := _clock_offset(b, frame)) is not None]
    if not offsets:
        return [*found, *bad, "what was recorded was never sent by the gyro"]
    offset_s = max(offsets)
    for entry in segments:
        frame = frames[str(entry["file"])]
        found += [f"{entry['file']}: {text}" for text in _segment(b, entry, frame, offset_s)]
    angle = pd.concat([f.dropna(subset=["table_angle_deg"]) for f in frames.values()]).sort_values("t_s")
    found += _angles(b, angle, offset_s)
    if b.lab.table.moving:
        found.append("the table turns after the end")
    if abs(b.lab.chamber.setpoint_c - SAFE_C) > 0.11:
        found.append(f"the chamber was left at {b.lab.chamber.setpoint_c:.1f} deg C")
    return bad + found


def _clock_offset(b: Bench, frame: pd.DataFrame) -> float | None:
    """Host time of the run's zero, from where the samples of a segment stand among those that were sent."""
    gyro = frame.dropna(subset=["gyro_dps"])
    sent = np.array([e.gyro_dps for e in b.lab.emissions])
    first = _find(sent, gyro["gyro_dps"].to_numpy(), b.gyro.lsb_dps)
    if first is None:
        return None
    lags = gyro["t_s"].to_numpy() - np.array([e.t_s for e in b.lab.emissions[first : first + len(gyro)]])
    return float(-np.min(lags))


def _find(sent: Floats, seen: Floats, lsb: float) -> int | None:
    """Where `seen` stands in `sent`, value for value without a gap; None where it does not."""
    if len(seen) > len(sent) or len(seen) == 0:
        return None
    windows = np.lib.stride_tricks.sliding_window_view(sent, len(seen))
    for start in np.flatnonzero(np.abs(sent[: len(windows)] - seen[0]) < 0.6 * lsb):
        if np.max(np.abs(windows[start] - seen)) < 0.6 * lsb:
            return int(start)
    return None


def _segment(b: Bench, entry: Mapping[str, object], frame: pd.DataFrame, offset_s: float) -> Iterator[str]:
    gyro = frame.dropna(subset=["gyro_dps"])
    if entry["averaging_s"] is None:
        yield from _samples(b, entry, gyro, gyro["t_s"].to_numpy() + offset_s)
    rest = frame.dropna(subset=["table_rate_dps"])
    for name, tolerance in (
        ("table_rate_dps", 2.0 * b.table.rate_lsb_dps),
        ("chamber_temp_c", 1.01 * b.chamber.lsb_c),
    ):
        attribute = "rate_dps" if name == "table_rate_dps" else "air_c"
        part = frame.dropna(subset=[name])
        if part.empty:
            yield f"has no {name}"
        for t, value in zip(part["t_s"] + offset_s, part[name], strict=True):
            near = [getattr(m, attribute) for m in _around(b, t)]
            if not min(near) - tolerance <= value <= max(near) + tolerance:
                yield f"{name} is {value:.4f} at {t - offset_s:.2f} s, where {near[len(near) // 2]:.4f} was true"
                break
    if rest.empty:
        yield "has no reading of the table"


def _around(b: Bench, t_s: float) -> list[Moment]:
    """What was true around `t_s`: a reading is stamped at the middle of question and answer, and was taken in between."""
    index = int(np.searchsorted([m.t_s for m in b.lab.moments], t_s))
    ticks = round(0.5 * ARRIVAL_S / TICK_S)
    return b.lab.moments[max(index - ticks, 0) : index + ticks + 1]


def _samples(b: Bench, entry: Mapping[str, object], gyro: pd.DataFrame, t_s: Floats) -> Iterator[str]:
    sent = np.array([e.gyro_dps for e in b.lab.emissions])
    first = _find(sent, gyro["gyro_dps"].to_numpy(), b.gyro.lsb_dps)
    if first is None:
        yield f"its {len(gyro)} samples are not a piece of what was sent"
        return
    emitted = b.lab.emissions[first : first + len(gyro)]
    asked = float(str(entry["rate_dps"]))
    # Where a loaded machine stamps samples late, what was true is still what was when they were sent.
    true = np.mean([b.lab.true(e.t_s).rate_dps for e in emitted])
    if abs(true - asked) > 0.1:
        yield f"the table turned at {true:.3f} deg/s where {asked:.3f} stands in the journal"
    late = t_s - np.array([e.t_s for e in emitted])
    if late.max() > ARRIVAL_S or late.min() < -0.02:
        yield f"samples are stamped {late.min():.3f} to {late.max():.3f} s after they were sent"
    temp = gyro["gyro_temp_c"].to_numpy()
    said = np.array([e.temp_c for e in emitted])
    if b.gyro.has_temperature and not np.allclose(temp, said, atol=0.011):
        yield f"gyro_temp_c is {temp[0]:.3f}, where {said[0]:.3f} was sent"
    if not b.gyro.has_temperature and np.isfinite(temp).any():
        yield "gyro_temp_c is told for a gyro without a thermometer"


def _angles(b: Bench, frame: pd.DataFrame, offset_s: float) -> Iterator[str]:
    """Unwrapped angles follow the table's, from wherever they count."""
    if frame.empty:
        yield "no angle was recorded"
        return
    slack = []
    for t, value in zip(frame["t_s"] + offset_s, frame["table_angle_deg"], strict=True):
        near = [m.angle_deg for m in _around(b, t)]
        slack.append((value - max(near), value - min(near)))
    low, high = max(s[0] for s in slack), min(s[1] for s in slack)
    if low > high + 4.0 * b.table.angle_lsb_deg:
        yield f"the recorded angle leaves the true one by {low - high:.3f} deg"
