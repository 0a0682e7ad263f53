"""A report with terms beside the surface: on a run, on a table with times and without, and a term nobody knows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal.calibration.datasets import load_recording
from gyrocal.calibration.material import Material, gather
from gyrocal.errors import CoefficientError
from gyrocal.fusion import Compensator, Term, load_coefficients

SAMPLE = Path(__file__).parents[2] / "sample_data"
SHUPE = Term("shupe", {"amplitude": {"value": 5.0, "std": 1.0, "unit": "mdeg/s per degC/min"}}, True)


def gathered(tmp_path: Path, recording: Path, term: Term) -> Material:
    """What the report is made of, with one term more in the sample coefficients."""
    coefficients = replace(load_coefficients(SAMPLE / "coefficients.json"), terms=(term,))
    (tmp_path / "c.json").write_text(coefficients.to_text(), encoding="utf-8")
    return gather(recording, tmp_path / "c.json", None, False, lambda share, what: None)


def test_terms_that_remember_are_applied_to_runs_and_to_tables_with_times(tmp_path: Path) -> None:
    on_table = gathered(tmp_path, SAMPLE / "data_sets.csv", SHUPE)
    sets = load_recording(SAMPLE / "data_sets.csv").sets
    coefficients = replace(load_coefficients(SAMPLE / "coefficients.json"), terms=(SHUPE,))
    wanted = Compensator(coefficients).correct(sets.t_s, sets.gyro_dps, sets.temp_c) - sets.rate_dps
    np.testing.assert_allclose(on_table.data.residual_dps, wanted)
    assert not any("surface alone" in note for note in on_table.notes)
    assert gathered(tmp_path, SAMPLE / "run", SHUPE).data.residual_dps.size == wanted.size


def test_a_table_without_times_gets_the_surface_alone_and_a_note(tmp_path: Path) -> None:
    bare = tmp_path / "bare.csv"
    rows = [line.split(",")[:3] for line in (SAMPLE / "data_sets.csv").read_text().splitlines()]
    bare.write_text("\n".join(map(",".join, rows)) + "\n")
    found = gathered(tmp_path, bare, SHUPE)
    sets = found.data.sets
    surface = found.coefficients.surface
    np.testing.assert_allclose(
        found.data.residual_dps, sets.error_dps - surface.error_dps(sets.gyro_dps, sets.temp_c)
    )
    assert any(note.startswith("shupe of the coefficients cannot be evaluated") for note in found.notes)


def test_a_term_that_nobody_knows_is_refused_with_the_files_name(tmp_path: Path) -> None:
    with pytest.raises(CoefficientError, match=r"c\.json: The coefficients' term 'nope' cannot be evaluated"):
        gathered(tmp_path, SAMPLE / "data_sets.csv", replace(SHUPE, effect="nope"))
