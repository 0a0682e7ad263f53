"""``gyrocal acquire`` as its user meets it: plan, run, summary, refusals, exit codes."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from gyrocal.bench.profile import load_profile
from gyrocal.bench.virtual.devices import gyro_of
from gyrocal.calibration.datasets import load_recording
from gyrocal.calibration.fit import SurfaceFit, fit_surface
from gyrocal.cli import main
from gyrocal.records.run import Run, read_run
from tests.bench.test_resume import toml
from tests.bench.tiny import tiny

Floats = NDArray[np.float64]


@pytest.fixture
def profile(tmp_path: Path) -> str:
    """The tiny profile on disk."""
    path = tmp_path / "tiny.toml"
    path.write_text(toml(tiny()))
    return str(path)


def run(*arguments: str) -> int:
    """Exit code of ``gyrocal`` with these arguments."""
    with pytest.raises(SystemExit) as caught:
        main(list(arguments))
    return int(caught.value.code or 0)


def test_dry_run_shows_steps_turns_duration_and_limits(
    profile: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("acquire", profile, "--dry-run", "--out", str(tmp_path / "r")) == 0
    out = capsys.readouterr().out
    assert not (tmp_path / "r").exists()
    assert re.search(r"^1 +ramp 21 to 20 °C +13 s +1 min$", out, re.MULTILINE)
    assert re.search(r"^max_rate_dps +100 +the gyro \(sensor\.rate_range_dps\)$", out, re.MULTILINE)
    assert "12 steps (8 rate, 0 static, 2 ramp, 2 soak): " in out
    assert re.search(r"Turns of the table: \d\.\d counter-clockwise, \d\.\d clockwise", out)
    assert out.endswith("Nothing has moved.\n")


def test_dry_run_as_json(profile: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("acquire", profile, "--dry-run", "--json") == 0
    plan = json.loads(capsys.readouterr().out)
    assert [step["kind"] for step in plan["steps"][:3]] == ["ramp", "soak", "rate"]
    assert plan["profile"] == "tiny.toml"
    assert plan["limits"]["max_ramp_c_per_min"] == {"value": 5.0, "whose": "the chamber"}


@pytest.mark.parametrize("name", ["quick", "rd2100", "scale_factor", "static_allan", "thermal_ramp"])
def test_every_shipped_profile_has_a_plan_within_its_limits(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("acquire", name, "--dry-run", "--json") == 0
    plan = json.loads(capsys.readouterr().out)
    hours = plan["expected_s"] / 3600.0
    assert 2.0 < hours < 14.0
    if name == "rd2100":
        assert hours > 10.0


def test_a_run_and_its_summary(profile: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "r"
    assert run("acquire", profile, "--out", str(out)) == 0
    said = capsys.readouterr()
    assert f"{out}: 12 segments recorded, 0 unsettled, 0 failed, 0 skipped." in said.out
    assert re.search(
        r"the table made 0\.\d turns counter-clockwise and 0\.\d clockwise, and stands\. ", said.out
    )
    assert "and stands. Seed of the virtual bench: 1." in said.out
    assert "acquire: 0%, ramp 21 to 20 °C" in said.err
    assert "of bench time left" in said.err
    assert len(read_run(out).segments) == 12


def test_a_run_as_json_is_nothing_but_json(
    profile: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("acquire", profile, "--out", str(tmp_path / "r"), "--seed", "11", "--json") == 0
    said = capsys.readouterr()
    summary = json.loads(said.out)
    assert summary["seed"] == 11
    assert summary["complete"] is True
    assert summary["recorded"] == 12
    assert said.err == ""


def test_run_json_says_what_formats_asks(profile: str, tmp_path: Path) -> None:
    out = tmp_path / "r"
    run("acquire", profile, "--out", str(out), "--seed", "5")
    head = json.loads((out / "run.json").read_text())
    assert set(head) == {
        "schema",
        "created_utc",
        "sensor",
        "bench",
        "power_on_t_s",
        "profile",
        "profile_sha256",
        "software",
        "identity",
        "simulated",
    }
    assert head["sensor"]["serial"] == "virtual-1"
    assert head["profile"]["virtual"]["seed"] == 5
    assert read_run(out).notes == ()


def test_unsettled_segments_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "p.toml"
    path.write_text(toml(tiny(settle__tolerance_dps=1e-5)))
    assert run("acquire", str(path), "--out", str(tmp_path / "r")) == 0
    said = capsys.readouterr()
    assert "8 segments recorded, 4 unsettled, 0 failed, 0 skipped." in said.out
    assert "  unsettled: rate at +30 deg/s, 20 °C" in said.out
    assert "within 10 s" in said.err


def test_failed_segments_end_in_an_exit_code_of_their_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "p.toml"
    path.write_text(toml(tiny(settle__tolerance_dps=1e-5, settle__on_deadline="fail")))
    out = tmp_path / "r"
    assert run("acquire", str(path), "--out", str(out)) == 12
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith(
        f"gyrocal: {out}: 4 segments failed and 0 were skipped, the first of them rate at "
    )


def test_refusals_have_their_exit_codes(
    profile: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "r")
    assert run("acquire", profile) == 2
    assert run("acquire", "nowhere", "--out", out) == 5
    hot = tmp_path / "hot.toml"
    hot.write_text(toml(tiny(limits__max_temp_c=22.0)))
    assert run("acquire", str(hot), "--out", out) == 8
    real = tmp_path / "real.toml"
    real.write_text(toml(tiny(gyro__device="/dev/ttyUSB0")))
    assert run("acquire", str(real), "--out", out) != 0
    assert not Path(out).exists()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").write_text("mine")
    assert run("acquire", profile, "--out", str(tmp_path / "full")) == 7
    capsys.readouterr()
    assert run("acquire", str(real), "--out", out, "--simulate") == 0


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="the superuser may write everywhere")
def test_a_read_only_output_is_refused(profile: str, tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    assert run("acquire", profile, "--out", str(tmp_path / "r")) == 7


@pytest.mark.parametrize("incomplete", [False, True])
def test_the_run_does_not_die_with_its_viewer(tmp_path: Path, incomplete: bool) -> None:
    path, out = tmp_path / "p.toml", tmp_path / "r"
    late = {"settle__tolerance_dps": 1e-5, "settle__on_deadline": "fail"} if incomplete else {}
    path.write_text(toml(tiny(plan__rates_dps=[90.0], **late)))
    command = [sys.executable, "-m", "gyrocal", "acquire", str(path), "--out", str(out)]
    reading, writing = os.pipe()
    process = subprocess.Popen(command, stdout=writing, stderr=writing)
    os.close(writing)
    os.close(reading)  # as `acquire ... 2>&1 | tee` does when tee is killed
    assert process.wait(60) == (12 if incomplete else 0)
    names = [e["event"] for e in read_run(out).events]
    assert "viewer_gone" in names
    assert names[-1] == "end"


def test_ctrl_c_ends_safely_and_resume_completes(tmp_path: Path) -> None:
    path, out = tmp_path / "p.toml", tmp_path / "r"
    path.write_text(toml(tiny(plan__rates_dps=[5.0 * k for k in range(1, 20)])))
    command = [sys.executable, "-m", "gyrocal", "acquire", str(path), "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not (out / "run.json").exists() and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.splitlines()[-2:] == [
        "gyrocal: Ended by Ctrl-C; what was sealed is kept, and --resume carries on.",
        "The table stands. The chamber is set to 22 °C.",
    ]
    events = [e["event"] for e in read_run(out).events]
    assert events[-2:] == ["make_safe", "aborted"]
    done = subprocess.run([*command, "--resume"], capture_output=True, text=True, check=True)
    assert "0 unsettled, 0 failed, 0 skipped" in done.stdout


def acquired(name: str, out: Path, seed: int) -> Run:
    """A shipped profile, run."""
    assert run("acquire", name, "--out", str(out), "--seed", str(seed)) == 0
    return read_run(out)


def miss(out: Path) -> tuple[SurfaceFit, Floats, NDArray[np.bool_]]:
    """Fit of a quick run; fitted minus true error over rate and temperature; which true terms lie inside 95 %."""
    recording = load_recording(out)
    fit = fit_surface(recording.sets, rest=recording.rest)
    spec = load_profile("quick")
    true = gyro_of(spec.virtual, spec.sensor.sample_rate_hz).surface
    gyro, temp = (a.ravel() for a in np.meshgrid(np.linspace(-100, 100, 21), np.linspace(-10, 50, 13)))
    design = fit.surface.design(gyro, temp)
    true_terms = np.linalg.lstsq(design, true.error_dps(gyro, temp), rcond=None)[0]
    inside = np.abs(fit.surface.coefficients_dps.ravel() - true_terms) < fit.half_width_dps().ravel()
    return fit, fit.surface.error_dps(gyro, temp) - true.error_dps(gyro, temp), inside


def test_a_quick_run_carries_the_true_surface(tmp_path: Path) -> None:
    acquired("quick", tmp_path / "r", 11)
    fit, error_dps, _ = miss(tmp_path / "r")
    # What cannot be told from the surface is the slow part of the bias noise, 1 mdeg/s, and the reference's
    # 10 ppm of 100 deg/s over the root of the data sets at a rate; five standard deviations.
    assert np.sqrt(np.mean(error_dps**2)) < 0.005
    assert np.sqrt(np.mean(fit.sets.error_dps**2)) > 0.3


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_quick_runs_are_honest_over_many_seeds(tmp_path: Path) -> None:
    shares = []
    for seed in range(20):
        acquired("quick", tmp_path / str(seed), seed)
        shares.append(np.mean(miss(tmp_path / str(seed))[2]))
    # 240 intervals of 95 %; the twelve of a run hang together like about four: once in 1,000 fewer than this
    assert np.mean(shares) >= stats.binom.ppf(1e-3, 80, 0.95) / 80


def test_an_injected_effect_is_seen(tmp_path: Path) -> None:
    means = {}
    for name, effects in (("with", {"shupe": {"amplitude": 20.0}}), ("without", {})):
        path = tmp_path / f"{name}.toml"
        path.write_text(toml(tiny(plan__temperatures_c=[20.0, 50.0], virtual__effects=effects)))
        recorded = acquired(str(path), tmp_path / name, 3)
        ramp = next(s for s in recorded.segments if s.kind == "ramp" and s.chamber_c == 50.0)
        means[name] = recorded.segment(ramp).gyro_dps
    # at the end of six minutes at 5 degC/min the case follows the ramp: times 20 mdeg/s
    shift = means["with"] - means["without"]
    assert np.mean(shift[-60:]) == pytest.approx(0.1, rel=0.05)


@pytest.mark.slow
def test_the_full_rd2100_plan_takes_seconds(tmp_path: Path) -> None:
    began = time.process_time()
    recorded = acquired("rd2100", tmp_path / "r", 1)
    assert time.process_time() - began < 30.0
    assert recorded.segments[-1].t_end_s > 10 * 3600.0
    assert {s.outcome for s in recorded.segments} == {"ok"}


@pytest.mark.slow
def test_a_full_disk_is_said_in_one_sentence(tmp_path: Path) -> None:
    small = tmp_path / "small"
    small.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", str(small)]
    if subprocess.run(mount, check=False, capture_output=True).returncode != 0:
        pytest.skip("mounting a small tmpfs is not allowed here")
    try:
        command = [sys.executable, "-m", "gyrocal", "acquire", "quick", "--out", str(small / "r")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 7
        assert "the disk is full" in done.stderr.splitlines()[-1]
        # what was sealed is whole, and the journal ends with a whole line
        recorded = read_run(small / "r")
        assert len(recorded.segments) > 0
        assert all(segment.record.outcome == "ok" for segment in recorded)
    finally:
        subprocess.run(["umount", str(small)], check=True)
