"""Closed loop on the virtual bench: an ambiguous run, the profile that is proposed, its run, no doubt left."""

from __future__ import annotations

from pathlib import Path

import pytest

from gyrocal.bench.session import AcquireConfig, acquire
from gyrocal.diagnosis.engine import diagnose
from gyrocal.planning.next_experiment import propose, to_toml
from gyrocal.records.run import read_run

#: It begins half an hour after power-on and goes through its temperatures once: a warm-up looks like a drift.
AMBIGUOUS = """
title = "A warm-up that looks like a drift"
[sensor]
model = "RD2100"
sample_rate_hz = 10.0
rate_range_dps = [-100.0, 100.0]
temp_range_c = [-40.0, 75.0]
on_before_s = 1800.0
[plan]
temperatures_c = [0.0, 25.0, 50.0]
temperature_order = "up"
rates_dps = [25.0, 50.0, 75.0, 100.0]
dwell_s = 10.0
[ramp]
rate_c_per_min = 3.0
[soak]
time_s = 900.0
slope_c_per_min = 50.0
slope_over_s = 60.0
[virtual.effects.warm_up]
amplitude = 16.0
tau_s = 2400.0
"""


class _Silent:
    """Nobody watches."""

    def progress(self, progress: object) -> None:
        """Nothing is shown."""

    def say(self, text: str) -> None:
        """Nothing is said."""


def _measure(profile: str, path: Path, seed: int) -> Path:
    source = path.with_suffix(".toml")
    source.write_text(profile)
    acquire(AcquireConfig(source, path, simulate=True, seed=seed), _Silent())
    return path


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_ambiguous_then_proposed_then_unambiguous(tmp_path: Path) -> None:
    run = read_run(_measure(AMBIGUOUS, tmp_path / "first", 1))
    doubtful = diagnose(run)
    (first,) = doubtful.effects
    assert {first.effect, *(a.effect for a in first.alternatives)} == {"warm_up", "bias_drift"}
    proposal = propose(doubtful, run.profile or {}, 8.0)
    assert proposal is not None
    assert proposal.profile is not None
    assert proposal.expected_power is not None
    # A drift that slows down is hardly told from a warm-up by any plan; a warm-up from it surely, from power-on.
    assert proposal.expected_power > 0.6
    (pair,) = proposal.separations
    assert pair.if_other is not None
    assert pair.if_other.power > 0.95
    assert proposal.profile["sensor"]["on_before_s"] == 0.0
    settled = diagnose(read_run(_measure(to_toml(proposal.profile), tmp_path / "second", 77)))
    assert settled.effects[0].effect == "warm_up"
    assert settled.effects[0].alternatives == ()
    low, high = settled.effects[0].parameters["tau_s"].interval_95
    assert low < 2400.0 < high
