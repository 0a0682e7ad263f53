"""The generator of concealed recordings itself: sound files, stated d', and no code in common with gyrocal."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from gyrocal.records.run import read_run
from tests.diagnosis.concealed_bench import NoiseLevels, Yardstick, make_recording, write_run
from tests.diagnosis.concealed_effects import CATALOGUE, OF_OUTPUT, OF_SURFACE
from tests.diagnosis.concealed_outside import OUTSIDE
from tests.diagnosis.concealed_world import PLANS, Floats, World, build_world

ROOM = Path(__file__).parent


def test_shares_no_code_with_gyrocal() -> None:
    for name in ("concealed_bench.py", "concealed_effects.py", "concealed_outside.py", "concealed_world.py"):
        tree = ast.parse((ROOM / name).read_text())
        imported = [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
        imported += [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
        assert not [m for m in imported if m.startswith("gyrocal")]


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(PLANS["even"], True, np.random.default_rng(1))


@pytest.mark.parametrize("name", [*CATALOGUE, *OUTSIDE])
def test_every_effect_is_finite_and_not_constant(name: str, world: World) -> None:
    maker = CATALOGUE[name] if name in CATALOGUE else OUTSIDE[name][0]
    unit, _ = maker(world, np.random.default_rng(2))
    rows = world.rows(unit)
    assert np.all(np.isfinite(rows))
    assert np.ptp(rows) > 0


@pytest.mark.parametrize("name", [*OF_SURFACE, *OF_OUTPUT])
def test_effects_of_surface_and_output_change_the_record(name: str) -> None:
    plain = make_recording([], seed=4, plan="even")
    r = make_recording([(name, 12.0)], seed=4, plan="even")
    assert [h.effect for h in r.hidden] == [name]
    assert np.any(r.gyro_dps != plain.gyro_dps)


def test_written_run_is_read_back_as_recorded(tmp_path: Path) -> None:
    r = make_recording([("shupe", 12.0)], seed=5, plan="even")
    write_run(r, tmp_path / "run")
    run = read_run(tmp_path / "run")
    assert run.power_on_t_s == 0.0
    segments = list(run)
    assert np.concatenate([s.gyro_dps for s in segments]) == pytest.approx(r.gyro_dps, abs=6e-7)
    assert np.concatenate([s.t_s for s in segments]) == pytest.approx(r.gyro_t_s, abs=6e-4)
    assert {s.record.kind for s in segments} == {"ramp", "soak", "rate"}


def test_same_seed_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_run(make_recording([("warm_up", 20.0)], seed=6, plan="even"), tmp_path / name)
    files = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*") if p.is_file())
    assert all((tmp_path / "a" / f).read_bytes() == (tmp_path / "b" / f).read_bytes() for f in files)


def test_d_prime_in_white_noise_is_that_of_least_squares() -> None:
    r = make_recording([("shupe", 7.0)], seed=8, plan="even", noise=NoiseLevels(1.389e-3, 1e-9, 0.0))
    w = r.world
    u, v = w.rows(w.rate_dps) / 100, (w.rows(w.case_c) - 20) / 30
    root = np.sqrt(w.row_seconds()) / 1.389e-3
    x = np.polynomial.polynomial.polyvander2d(u, v, [3, 2]) * root[:, None]
    signal = r.effect_dps[0] * root
    left = signal - x @ np.linalg.lstsq(x, signal, rcond=None)[0]
    # The record projects the surface out in the output, this test in the rate: 1.5 % apart at most.
    assert float(np.linalg.norm(left)) == pytest.approx(7.0, rel=0.03)


@pytest.mark.slow
def test_d_prime_under_flicker_noise_is_what_an_ideal_receiver_reaches() -> None:
    """z scores of the receiver that knows signal and noise are standard normal (KS, false alarms 1e-3)."""
    scores = []
    for seed in range(60):
        r = make_recording([("bias_drift", 8.0)], seed, plan="even")
        clean = r.world.rows(r.world.rate_dps)
        output = r.gyro_dps
        columns: Floats = np.asarray(
            np.polynomial.polynomial.polyvander2d(
                output / 100, (r.world.rows(r.world.case_c) - 20) / 30, [3, 2]
            )
        )
        value, sd = Yardstick(r.world, r.noise, columns).amplitude(r.effect_dps[0], output - clean)
        scores.append((value - 1.0) / sd)
    assert stats.kstest(scores, "norm").pvalue > 1e-3
