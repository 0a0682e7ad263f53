"""What the search of a table offers, and whether its correction makes another run better."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.answer.fresh_run import Gain, gain_on_a_fresh_run, no_file, without_rate
from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.examine import examine
from gyrocal.diagnosis.model.layers import full_model
from gyrocal.diagnosis.model.parts import polynomials
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Improvement
from gyrocal.diagnosis.rows.means import Means, means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.sweeps.changes import Change
from gyrocal.diagnosis.sweeps.coil import table_search
from gyrocal.errors import DataError
from gyrocal.fusion import Coefficients, Term, Valid
from gyrocal.physics.rate_shapes import LOCKED
from gyrocal.physics.surface import SHAPE, Surface
from gyrocal.records.datasets import DataSetTable
from tests.diagnosis.test_layers import sweeps


@pytest.fixture(scope="module")
def means() -> Means:
    """Rows of a table of sweeps."""
    return means_of(series_of_table(sweeps(1)[0]))


def surface(constant_dps: float, variance_dps2: float = 1e-12) -> Coefficients:
    c = np.zeros(SHAPE)
    c[0, 0] = constant_dps
    spread = np.zeros((12, 12))
    spread[0, 0] = variance_dps2
    return Coefficients({}, Surface(c, 0.0, 100.0, 25.0, 10.0), spread, Valid((-100, 100), (0, 50)))


def test_the_chance_of_gain_is_that_of_the_stated_uncertainty(means: Means) -> None:
    """A bias that was found to be 2 deviations off is better corrected wherever it is more than half of that."""
    for improved, chance, ratio in (
        (surface(0.02), 1.0, 0.0),
        (surface(0.02, 0.01**2), 0.841, 5.0**-0.5),
        (surface(0.02, 1.0), 0.504, 1.0),
        (surface(0.0), 0.5, 1.0),
    ):
        gain = gain_on_a_fresh_run(improved, surface(0.0), means)
        assert gain.chance == pytest.approx(chance, abs=2e-3)
        assert gain.error_ratio == pytest.approx(ratio, abs=2e-3)


def test_what_is_lost_in_a_dead_zone_counts_although_few_rates_are_in_it(means: Means) -> None:
    """A fifth of a degree a second of a hundred: of even rates next to none is in it, and a little doubt of the bias outweighs it."""
    # A zone that is known well, about rates that were visited.
    slow = replace(means, rate_dps=np.where(np.abs(means.rate_dps) < 15.0, 0.1, means.rate_dps))
    values = {"amplitude": 50.0, "width_dps": 0.2, "form": LOCKED, "rest": 0.0, "place_dps": 0.0}
    zone = Term("dead_zone", {name: {"value": value, "std": 0.0} for name, value in values.items()}, True)
    doubtful = replace(surface(0.0, 0.01**2), terms=(zone,))
    assert gain_on_a_fresh_run(doubtful, surface(0.0), slow).chance > 0.95


def test_a_file_is_written_that_is_surely_or_much_better() -> None:
    assert [Gain(*of).is_enough for of in ((0.9, 0.95), (0.7, 0.6), (0.7, 0.9))] == [True, True, False]


@pytest.mark.parametrize(
    ("kept", "lacks"),
    [
        (lambda m: m.rate_dps > -1e9, {}),
        (lambda m: m.rate_dps >= 0.0, {"one_way": True}),
        (lambda m: np.abs(m.rate_dps) == np.abs(m.rate_dps).max(), {"rates": 2}),
    ],
)
def test_the_reason_why_there_is_no_file_is_this_recordings(
    means: Means, kept: Callable[[Means], NDArray[np.bool_]], lacks: dict[str, Any]
) -> None:
    rows = kept(means)
    part = replace(
        means,
        **{name: getattr(means, name)[rows] for name in ("t_s", "rate_dps", "gyro_dps", "temp_c")},
        supply_v=None,
    )
    remark = no_file(surface(0.0), part, 0.6, None)
    nothing = {
        "chance": 0.6,
        "rates": 0,
        "temps": 0,
        "one_way": False,
        "no_gain": False,
        "surface_alone": True,
    }
    assert remark == Remark(Said.NO_SURE_GAIN, nothing | lacks)


def test_few_temperatures_are_a_reason(means: Means) -> None:
    part = replace(means, temp_c=np.where(means.t_s < np.median(means.t_s), 20.0, 30.0))
    assert no_file(surface(0.0), part, 0.6, None).facts["temps"] == 2


def test_a_gain_that_data_left_out_do_not_show_is_a_reason(means: Means) -> None:
    for low, no_gain in ((-0.1, True), (0.1, False)):
        gain = Improvement(1.0, 1.0, 1.0, (-1.0, 1.0), 0.0, 0.0, (low, 1.0), 0.0, Remark(Said.LEFT_OUT_SETS))
        assert no_file(surface(0.0), means, 0.6, gain).facts["no_gain"] is no_gain


def test_outputs_that_no_rate_gives_are_the_reason_before_all_others(means: Means) -> None:
    bent = surface(0.0)
    c = bent.surface.coefficients_dps.copy()
    c[2, 0] = 100.0
    bent = replace(bent, surface=replace(bent.surface, coefficients_dps=c, direction="input"))
    remark = no_file(bent, means, 0.5, None)
    assert remark.said is Said.NO_INVERSE
    assert remark.facts["count"] == without_rate(bent, means).size > 0


def test_where_nothing_is_found_a_surface_without_inverse_is_refused_as_fit_does() -> None:
    rng = np.random.default_rng(5)
    rate = np.tile(np.linspace(-100.0, 100.0, 15), 6)
    temp = np.repeat(np.linspace(-20.0, 60.0, 6), 15) + 0.05 * rng.standard_normal(90)
    gyro = 1.01 * rate + 0.2 - 0.01 * rate**2 + 0.003 * rng.standard_normal(90)
    said = r"folded\.csv: by the fitted surface 4\d data sets have an output that no rate gives .* leave these out\."
    with pytest.raises(DataError, match=said):
        diagnose(DataSetTable(Path("folded.csv"), rate, gyro, temp), options=Options(heldout=False))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 9])
def test_where_nothing_is_found_no_file_is_written(seed: int) -> None:
    """A bias that walks has an end, and the next run begins elsewhere: 13 deg/h had become 64 with nothing to say of it."""
    rng = np.random.default_rng(seed)
    rate = np.concatenate([sign * np.linspace(0.0, 120.0, 11) for sign in (1.0, -1.0) * 3])
    t: NDArray[np.float64] = 60.0 * np.arange(rate.size, dtype=np.float64)
    temp = 25.0 + 4.0 * np.sin(t / 1500.0) + 0.3 * rng.standard_normal(rate.size)
    walk = 2e-3 * np.cumsum(rng.standard_normal(rate.size))
    gyro = 1.001 * rate + 0.02 + walk + 3e-3 * rng.standard_normal(rate.size)
    table = DataSetTable(Path("null.csv"), rate, gyro, temp, t_s=t)
    assert examine(series_of_table(table), 0.01).candidates
    found = diagnose(table, options=Options(heldout=False))
    assert found.verdict == "consistent"
    assert found.improved is None


def test_a_warm_up_comes_again_and_a_drift_moves_no_level(means: Means) -> None:
    search = table_search(full_model(means, memory=False))
    warm, drift = (search.changes.law(c) for c in (Change("warm_up", 478.0), Change("bias_drift", 1.0)))
    assert (warm.from_end, drift.from_end) == (False, True)
    np.testing.assert_allclose(warm.columns[:, 0], 1e-3 * np.exp(-means.t_s / 478.0), rtol=1e-12)
    assert drift.columns.mean() == pytest.approx(0.0, abs=1e-15)


def test_neighbouring_shapes_lie_on_the_lattice(means: Means) -> None:
    search = table_search(full_model(means, memory=False))
    step = Change("scale_step", 10.0)
    start: Any = replace(search.fit(None, (), None), coil=(1.0, 30.0), changes=(step,))
    rises = search.changes.grids("scale_step")[1]
    assert set(search.reshaped(start)) == {
        ((0.85, 30.0), (step,)),
        ((1.0, 37.8), (step,)),
        ((1.0, 30.0), (step._replace(at=9.0),)),
        ((1.0, 30.0), (step._replace(at=11.0),)),
        ((1.0, 30.0), (step._replace(spread=rises[1]),)),
    }


def test_shapes_in_temperature_are_freed_of_the_surface_at_the_coil(means: Means) -> None:
    """What the fit takes of them is what the surface of the file, which lags, gives back."""
    model = table_search(full_model(means, memory=False)).model((1.0, 237.6), ())
    part = next(p for p in model.parts if p.name == "temperature on bias")
    taken = model.design @ polynomials(part.columns, model.basis.frame)
    found = model.components[part.name].columns
    assert found is not None
    np.testing.assert_allclose(found + taken, model.basis.at(part.columns), atol=1e-12)
