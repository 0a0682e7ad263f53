"""Patterns of the table angle that data sets show between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrocal.diagnosis.engine import series_of
from gyrocal.diagnosis.laws.estimates import of_pattern
from gyrocal.diagnosis.model.layers import full_model
from gyrocal.diagnosis.model.starts import fit_anyhow
from gyrocal.diagnosis.model.within import Pattern, patterns
from gyrocal.diagnosis.names import between
from gyrocal.diagnosis.names.between import between_sets
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.series import Series
from gyrocal.units import MDPS
from tests.diagnosis.concealed_bench import make_recording, write_run

_LEVEL = 0.01


@pytest.fixture(scope="module")
def parts_of_a_turn(tmp_path_factory: pytest.TempPathFactory) -> Series:
    """A run whose data sets begin anywhere and turn through a twentieth of a turn each."""
    run = tmp_path_factory.mktemp("between") / "run"
    write_run(make_recording([], 23, "even"), run)
    series = series_of(run)
    begins_deg = np.random.default_rng(4).uniform(0.0, 360.0, int(series.set_index.max()) + 1)
    assert series.since_set_s is not None
    through = series.since_set_s / np.max(series.since_set_s[series.is_set])
    return replace(series, angle_deg=begins_deg[series.set_index] + 18.0 * through * np.sign(series.rate_dps))


def _between(series: Series) -> Pattern | None:
    return between_sets(fit_anyhow(full_model(means_of(series))), [], _LEVEL)


def test_what_sets_hardly_show_within_is_seen_between_them(parts_of_a_turn: Series) -> None:
    series = parts_of_a_turn
    assert series.angle_deg is not None
    size_mdps, phase_rad = 1.5, 0.8
    tilted = size_mdps * MDPS * np.cos(np.deg2rad(series.angle_deg) - phase_rad)
    tilted_series = replace(series, gyro_dps=series.gyro_dps + tilted)
    assert not patterns(tilted_series, _LEVEL)
    found = _between(tilted_series)
    assert found is not None
    assert found.effect == "earth_rate_tilt"
    known = of_pattern(found)
    for name, true in (("amplitude", size_mdps), ("phase_rad", phase_rad)):
        low, high = known[name].interval_95
        assert low < true < high
    assert known["amplitude"].std < 0.3 * size_mdps
    np.testing.assert_allclose(np.std(found.values - tilted), 0.0, atol=0.3 * size_mdps * MDPS)


def test_where_nothing_follows_the_angle_nothing_is_found(parts_of_a_turn: Series) -> None:
    assert _between(parts_of_a_turn) is None


def test_what_begins_at_one_angle_for_each_rate_may_be_a_shape_in_the_rate(parts_of_a_turn: Series) -> None:
    rates = np.unique(np.round(parts_of_a_turn.rate_dps, 2), return_inverse=True)[1]
    angle_deg = np.random.default_rng(5).uniform(0.0, 360.0, int(rates.max()) + 1)[rates]
    tilted = 1.5 * MDPS * np.cos(np.deg2rad(angle_deg))
    series = replace(parts_of_a_turn, angle_deg=angle_deg, gyro_dps=parts_of_a_turn.gyro_dps + tilted)
    assert _between(series) is None


@pytest.mark.parametrize("std", [0.2, 0.8])
def test_what_sets_tell_within_and_deny_between_them_is_none(
    std: float, parts_of_a_turn: Series, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both are improbable by chance, and together they hold zero."""

    def told(within: Pattern, *_: object) -> Pattern:
        size = within.amplitudes.size
        return replace(
            within,
            amplitudes=np.full(size, size**-0.5),
            covariance=std**2 * np.eye(size),
            p_value=1e-9,
            dof=100.0,
        )

    monkeypatch.setattr(between, "_with_means", told)
    assert (_between(parts_of_a_turn) is None) == (std > 0.5)
