"""What a simulated drive lacks, from the figures of both."""

from __future__ import annotations

import json
from collections.abc import Collection
from types import SimpleNamespace
from typing import cast

import pytest

from gyrocal.diagnosis.drive.engine import DriveDiagnosis
from gyrocal.diagnosis.drive.estimates import DriveEstimate
from gyrocal.diagnosis.result import Estimate, NamedEffect
from gyrocal.diagnosis.versus.drive import drive_versus
from gyrocal.report.versus_drive import drive_law_file, drive_told


def drive(
    name: str, figures: dict[str, tuple[float, float]], *effects: str, believed: Collection[str] = ()
) -> DriveDiagnosis:
    """A diagnosis with these figures (value and standard deviation) and names."""
    estimates = [
        DriveEstimate(n, value, std, "%", 0.1, "truth" if n.startswith("truth") else "gyro", n in believed)
        for n, (value, std) in figures.items()
    ]
    amplitude = {"amplitude": Estimate(1.0, 0.1, "%", (0.8, 1.2))}
    named = [NamedEffect(e, "wheel geometry", amplitude, 1e-6, (), None, False) for e in effects]
    diagnosis = SimpleNamespace(recording=name, verdict="explained", effects=named)
    return cast(DriveDiagnosis, SimpleNamespace(estimates=estimates, diagnosis=diagnosis))


def test_what_differs_is_to_be_added_and_what_does_not_is_said() -> None:
    real = drive("real.csv", {"wheel_asymmetry": (0.30, 0.01), "gyro_scale": (0.02, 0.02)}, "wheel_asymmetry")
    simulated = drive("sim.csv", {"wheel_asymmetry": (0.05, 0.01), "gyro_scale": (0.0, 0.02)}, "unit_or_sign")
    found = drive_versus(real, simulated)
    first, second = found.figures
    assert (first.name, first.differs, second.differs) == ("wheel_asymmetry", True, False)
    assert first.lacking.value == pytest.approx(0.25)
    assert first.lacking.interval_95 == pytest.approx((0.25 - 0.0277, 0.25 + 0.0277), abs=1e-4)
    law = json.loads(drive_law_file(found))
    assert law["figures"][0]["lacking"]["value"] == pytest.approx(0.25)
    assert [e["effect"] for e in law["effects"]] == ["wheel_asymmetry"]
    said = " ".join(drive_told(found))
    assert "Wheel asymmetry is 0.300 % (95 %: 0.280 to 0.320), in the simulation 0.050 %" in said
    assert "No difference is seen in gyro scale." in said
    assert "Named in sim.csv and not in real.csv: unit_or_sign." in said


def test_the_track_is_told_from_the_scales_where_both_drives_know_them() -> None:
    """Encoder turn over gyro turn is (1 + track)(1 + wheels)/(1 + gyro): both cannot be added.

    Where the truth is believed about a scale, what is told of the track is without it already: there it counted twice.
    """
    scales = {"gyro_scale": (0.5, 0.01), "wheel_scale": (0.2, 0.01)}
    ratio = 100.0 * (1.03 * 1.002 / 1.005 - 1.0)
    real = drive("real.csv", {"effective_track": (ratio, 0.01), **scales})
    simulated = drive(
        "sim.csv", {"effective_track": (0.0, 0.01), "gyro_scale": (0, 0.01), "wheel_scale": (0, 0.01)}
    )
    lacking = {f.name: f.lacking.value for f in drive_versus(real, simulated).figures}
    assert lacking == pytest.approx({"track": 3.0, "gyro_scale": 0.5, "wheel_scale": 0.2})
    free = drive("free.csv", {"effective_track": (3.0, 0.01), **scales}, believed=scales)
    lacking = {f.name: f.lacking.value for f in drive_versus(free, simulated).figures}
    assert lacking == pytest.approx({"track": 3.0, "gyro_scale": 0.5, "wheel_scale": 0.2})
    alone = drive("sim.csv", {"effective_track": (0.0, 0.01)})
    assert [f.name for f in drive_versus(real, alone).figures] == ["effective_track"]


def test_how_the_truth_was_measured_is_no_figure_of_the_robot() -> None:
    both = [drive(n, {"truth_clock": (0.1, 0.01), "wheel_asymmetry": (0.1, 0.01)}) for n in ("a", "b")]
    assert [f.name for f in drive_versus(*both).figures] == ["wheel_asymmetry"]
