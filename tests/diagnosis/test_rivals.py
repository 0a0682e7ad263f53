"""What else a law may be, and what four temperatures cannot tell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.laws.at_rows import Laws, laws_of
from gyrocal.diagnosis.laws.estimates import likely_shapes
from gyrocal.diagnosis.laws.in_place import Named
from gyrocal.diagnosis.laws.jumps import boundaries
from gyrocal.diagnosis.model.layers import Fitted, Law, fit_model, full_model, surface_of
from gyrocal.diagnosis.model.parts import EACH_RATE, ODD
from gyrocal.diagnosis.names.rivals import or_lasting, or_passing, with_rivals
from gyrocal.diagnosis.rows.means import Means, means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.sweeps.coil import TOLL_NATS
from gyrocal.physics.effect import Effect
from gyrocal.physics.rate import RATE_ORDER, SATURATION
from gyrocal.physics.thermal import THERMAL_HYSTERESIS, THERMAL_LAG
from gyrocal.physics.timewise import SCALE_STEP
from gyrocal.records.datasets import DataSetTable

Floats = NDArray[np.float64]


_SIZES_DPS = np.array([10.0, 30.0, 50.0, 70.0, 90.0, 100.0])


def _means(temps_c: Floats, error_dps: float = 0.0, sizes: Floats = _SIZES_DPS) -> Means:
    """Rates up and down at each temperature; an error of the fifth order in the rate."""
    rates = np.concatenate([-sizes[::-1], [0.0], sizes])
    rate_dps, temp_c = np.tile(rates, temps_c.size), np.repeat(temps_c, rates.size)
    noise = 1e-3 * np.random.default_rng(2).standard_normal(rate_dps.size)
    gyro_dps = rate_dps + error_dps * (rate_dps / 100.0) ** 5 + noise
    t_s = 60.0 * np.arange(rate_dps.size, dtype=np.float64)
    return means_of(series_of_table(DataSetTable(Path("t.csv"), rate_dps, gyro_dps, temp_c, t_s=t_s)))


def _with(means: Means, effect: Effect, shape: dict[str, float]) -> tuple[Fitted, Law, Laws]:
    """A model of surface, white noise and one law."""
    model = full_model(means)
    kept = {"white", *(p.name for p in model.parts if p.block == "surface")}
    fitted = fit_model(model.without([n for n in model.components if n not in kept]))
    laws = laws_of(means, surface_of(fitted.model, fitted.solve()))
    law = Law(effect.id, shape, laws.at(effect, shape))
    return fitted.refit(fitted.model.with_laws(law)), law, laws


def test_a_rival_stands_in_the_file_by_how_likely_it_is() -> None:
    fitted, law, laws = _with(
        _means(np.array([20.0, 30.0, 40.0]), 6e-3), SATURATION, {"knee_dps": 60.0, "softness_dps": 0.0}
    )
    named = Named(law, "odd rate", 20.0, 1.0, {RATE_ORDER.id: 0.5, "scale_asymmetry": 30.0}, 40)
    found = with_rivals(fitted, [named], laws)
    assert [m.model.laws[-1].effect for _, m in found] == [SATURATION.id, RATE_ORDER.id]
    (own, _), (other, rival) = found
    orders = sum(t.columns.shape[1] == 1 for t in laws.trials(RATE_ORDER))
    behind = (rival.nll + 0.5 * np.log(orders) - RATE_ORDER.search.prior_nats) - (
        fitted.nll + 0.5 * np.log(named.trials)
    )
    assert own + other == pytest.approx(1.0)
    assert other / own == pytest.approx(np.exp(-behind), rel=1e-6)


def test_shapes_in_rate_stand_in_for_errors_of_each_rate() -> None:
    """What a few rates show is the table's or the gyro's, and in the file by how likely it is the gyro's."""
    means = _means(np.array([20.0, 30.0, 40.0]), 6e-3)
    model = full_model(means)
    kept = {"white", EACH_RATE, *(p.name for p in model.parts if p.block == "surface")}
    drawn = fit_model(model.without([n for n in model.components if n not in kept]))
    laws = laws_of(means, surface_of(drawn.model, drawn.solve()))
    (own, first), (other, shaped) = with_rivals(drawn, [], laws)
    assert first is drawn
    assert shaped.model.of_block(ODD)
    assert not shaped.model.of_block(EACH_RATE)
    assert own + other == pytest.approx(1.0)
    assert other / own == pytest.approx(np.exp(drawn.nll - shaped.nll - TOLL_NATS))


def test_what_wanders_stands_in_for_a_law_of_what_passes() -> None:
    """Of nothing but noise a step is no likelier than a walk, and pays for its instant."""
    fitted, law, laws = _with(_means(np.linspace(20.0, 45.0, 6)), SCALE_STEP, {"at_s": 2000.0})
    found = with_rivals(fitted, [Named(law, "scale in time", 9.0, 1.0, {}, 1)], laws)
    (own, _), (other, wandering) = found
    assert not wandering.model.laws
    assert "scale walk" in wandering.model.components
    assert other / own == pytest.approx(np.exp(fitted.nll + TOLL_NATS - wandering.nll), rel=1e-6)
    tried = with_rivals(fitted, [Named(law, "scale in time", 9.0, 1.0, {}, 1000)], laws)
    assert [m.model.laws for _, m in tried] == [()]


@pytest.mark.parametrize("lagging", [True, False])
def test_a_step_between_temperatures_that_come_once_is_told_from_a_lag(lagging: bool) -> None:
    means = _means(np.array([20.0, 26.0, 30.0, 36.0, 39.0, 45.0]))
    coil_c = means.temp_c.copy()
    for k in range(1, coil_c.size):
        coil_c[k] = means.temp_c[k] + (coil_c[k - 1] - means.temp_c[k]) * np.exp(-60.0 / 200.0)
    at_s = float(means.t_s[13 * 2] - 30.0)
    ppm = 100.0 * (coil_c if lagging else means.temp_c + (means.t_s > at_s))
    means = replace(means, gyro_dps=means.gyro_dps + 1e-6 * ppm * means.rate_dps)
    fitted, step, laws = _with(means, SCALE_STEP, {"at_s": at_s})
    lag = Law(THERMAL_LAG.id, {"tau_s": 200.0}, laws.at(THERMAL_LAG, {"tau_s": 200.0}))
    followed = Named(lag, "memory", 9.0, 1.0, {}, 18)
    found, named = or_lasting(fitted, [Named(step, "scale in time", 9.0, 1.0, {}, 18)], [followed], laws)
    first, other = (lag, step) if lagging else (step, lag)
    assert [law.name for law in found.model.laws] == [first.name]
    ((own, rivals),) = [(n.law.effect, n.rivals) for n in named]
    assert own == first.effect
    assert rivals.keys() == {other.effect}
    assert rivals[other.effect] > 0.0


@pytest.mark.parametrize(("jumped", "up_and_down"), [(True, False), (False, True), (True, True)])
def test_what_follows_the_temperature_is_told_from_a_jump_in_its_place(
    jumped: bool, up_and_down: bool
) -> None:
    """A play of the scale factor can follow a jump between two temperatures, and a walk hides it."""
    turned_c = np.array([24.0, 20.0, 28.0, 36.0, 44.0, 52.0, 60.0])
    temps_c = np.concatenate([turned_c, turned_c[-2::-1]]) if up_and_down else turned_c
    means = _means(temps_c)
    shape = {"width_c": 3.0, "of_scale": 1.0}
    _, play, laws = _with(means, THERMAL_HYSTERESIS, shape)
    at_s = float(means.t_s[13 * 3] - 30.0)
    hidden = 3e-4 * means.rate_dps * (means.t_s > at_s) if jumped else 5.0 * play.columns[:, 0]
    means = replace(means, gyro_dps=means.gyro_dps + hidden)
    fitted, play, laws = _with(means, THERMAL_HYSTERESIS, shape)
    without = fitted.refit(replace(fitted.model, laws=()))
    named = Named(play, "memory", without.nll - fitted.nll, 1.0, {}, 18)
    found, (only,) = or_passing(fitted, [named], laws)
    law, rival = (SCALE_STEP, THERMAL_HYSTERESIS) if jumped else (THERMAL_HYSTERESIS, SCALE_STEP)
    assert only.law.effect == law.id
    assert [one.effect for one in found.model.laws] == [law.id]
    assert only.rivals[rival.id] > 3.0
    assert only.p_value < 1e-6


def test_a_law_without_rivals_stands_alone() -> None:
    fitted, law, laws = _with(
        _means(np.array([20.0, 30.0, 40.0]), 6e-3), SATURATION, {"knee_dps": 60.0, "softness_dps": 0.0}
    )
    assert with_rivals(fitted, [Named(law, "odd rate", 20.0, 1.0, {}, 40)], laws) == [(1.0, fitted)]


@pytest.mark.parametrize(("temperatures", "told"), [(1, True), (4, False), (5, True)])
def test_four_temperatures_do_not_tell_what_changes_the_scale_factor(temperatures: int, told: bool) -> None:
    """The surface takes three numbers: one more is as well a step as a lag or an order. At one a drift is seen."""
    up_and_down = [*range(1, temperatures, 2), *reversed(range(0, temperatures, 2))]
    means = _means(np.linspace(0.0, 40.0, temperatures)[up_and_down])
    components = full_model(means).components
    assert ("scale line" in components) is told
    # Within a visit a step is told from all of them.
    rows, begins = boundaries(means, SCALE_STEP.id), np.flatnonzero(np.diff(means.temp_c)) + 1
    assert rows.size
    assert temperatures == 1 or np.isin(begins, rows).any() == told
    of_temperature = {"temperature orders on scale", "lag on scale", "play on scale"}
    assert of_temperature.isdisjoint(components) or of_temperature <= components.keys()
    assert ("lag on scale" in components) is (temperatures > 4)
    assert ("temperature rate" in components) is (temperatures > 1)


def test_a_knee_between_two_rates_may_be_sharp_and_near_or_soft_and_far() -> None:
    """Of the shapes that are best among those next to them one had been asked, and the file was sure of it."""
    means = _means(np.linspace(-10.0, 50.0, 5), 0.0, sizes=np.array([6.85, 17.8, 34.3, 39.1, 60.0]))
    softly_dps = 3.0 * np.logaddexp(0.0, (np.abs(means.rate_dps) - 46.7) / 3.0) * np.sign(means.rate_dps)
    means = replace(means, gyro_dps=means.gyro_dps + 0.02 * softly_dps)
    fitted, law, laws = _with(means, SATURATION, {"knee_dps": 40.6, "softness_dps": 1.2})
    likely = likely_shapes(fitted, law, laws)
    assert sum(weight for weight, _, _ in likely) == pytest.approx(1.0)
    softness = {shape["softness_dps"] for _, shape, _ in likely}
    assert len(softness) > 1
    knees_dps = [shape["knee_dps"] for weight, shape, _ in likely if weight > 1e-3]
    assert min(knees_dps) < 41.0
    assert max(knees_dps) > 44.0
