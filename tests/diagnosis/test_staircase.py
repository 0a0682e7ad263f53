"""Every layer is a step of the staircase, also what is no component of the model: a lag of the coil, laws of time."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from matplotlib.text import Annotation
from scipy.stats import multivariate_normal, norm

from gyrocal.diagnosis.answer.locate import binned
from gyrocal.diagnosis.answer.staircase import LeftOut, folds_of, leave_out, left_out_by
from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.model.layers import Fitted, Model
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Diagnosis, Layer, UnnamedPart
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.inference.additive import Component
from gyrocal.report.diagnosis import figures
from gyrocal.report.diagnosis import tables as tables_of
from gyrocal.report.diagnosis_layers import (
    layer_rows,
    not_a_step,
    staircase_figure,
    staircase_sentence,
    unnamed_sentences,
)
from tests.diagnosis.versus.tables import SURFACE, plan, table

NOISE_DPS = 3e-4
STEP = 400e-6


@pytest.fixture(scope="module")
def stepped() -> Diagnosis:
    """A table whose scale factor jumps by 400 ppm in the middle."""
    t, rate, temp = plan(8)
    noise = np.random.default_rng(2).normal(0, NOISE_DPS, t.size)
    gyro = SURFACE.output_dps(rate, temp) + STEP * rate * (t > t[-1] / 2) + noise
    return diagnose(series_of_table(table("stepped.csv", t, rate, gyro, temp)), None, Options())


def test_what_is_left_out_is_predicted_by_the_law_of_all_others() -> None:
    """By the conditional normal law, with the flat columns of a variance beyond all measure."""
    rng = np.random.default_rng(4)
    n, out = 12, np.array([2, 3, 9])
    flat = np.column_stack([np.ones(n), np.arange(n) / n])
    columns, y = rng.standard_normal((n, 3)), rng.standard_normal(n)
    parts = [Component("part", columns), Component("white", covariance=np.eye(n))]
    variance = {"part": 0.7, "white": 0.4}
    means = SimpleNamespace(set_index=np.arange(n), t_s=np.arange(n))
    model = SimpleNamespace(design=flat, flat=(0, 1), error_dps=y, all=parts, means=means)
    fitted = SimpleNamespace(fit=SimpleNamespace(variance=variance))
    found = leave_out(cast(Fitted, fitted), cast(Model, model), [out])
    v = 0.7 * columns @ columns.T + 0.4 * np.eye(n) + 1e5 * flat @ flat.T
    rest = np.setdiff1d(np.arange(n), out)
    gain = np.linalg.solve(v[np.ix_(rest, rest)], v[np.ix_(rest, out)]).T
    law = multivariate_normal(gain @ y[rest], v[np.ix_(out, out)] - gain @ v[np.ix_(rest, out)])
    np.testing.assert_allclose(found.squares, (y[out] - law.mean) ** 2, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(found.variance, np.diag(law.cov), rtol=1e-3)


def test_the_log_loss_has_the_noise_that_the_errors_show() -> None:
    """A model that errs ten times as much makes a row a tenth as probable, however small it takes the noise to be."""
    rng = np.random.default_rng(6)
    variance, drawn = rng.uniform(0.5, 2.0, 4000), rng.standard_normal(4000)
    rows = rng.uniform(size=4000) < 0.9
    errs = [LeftOut(size**2 * variance * drawn**2, variance, np.arange(4000)) for size in (1.0, 10.0)]
    one, ten = (found.logloss(rows).mean() for found in errs)
    assert ten - one == pytest.approx(np.log(10.0))
    # Of the noise that it has it is the log-loss itself.
    law = np.asarray(-norm.logpdf(drawn * np.sqrt(variance), scale=np.sqrt(variance)))
    assert one == pytest.approx(law[rows].mean(), abs=0.01)


def test_the_surface_alone_is_fitted_without_what_is_left_out() -> None:
    t, rate, temp = plan(8)
    gyro = SURFACE.output_dps(rate, temp) + np.random.default_rng(2).normal(0, NOISE_DPS, t.size)
    means = means_of(series_of_table(table("plain.csv", t, rate, gyro, temp)))
    folds = folds_of(means)
    rows = np.concatenate(folds)
    found = left_out_by(SURFACE, means, folds, np.ones(rows.size))
    assert np.sqrt(found.squares.mean()) == pytest.approx(NOISE_DPS, rel=0.2)
    # An output that is off is not in the fit that predicts it.
    k = int(folds[0][0])
    off = replace(means, gyro_dps=means.gyro_dps + 0.01 * (np.arange(len(means)) == k))
    again = left_out_by(SURFACE, off, folds, np.ones(rows.size))
    assert np.sqrt(again.squares[0]) == pytest.approx(0.01, abs=5.0 * NOISE_DPS)


def test_an_error_is_one_without_what_neighbours_tell_of_the_noise() -> None:
    """By the conditional normal law of what passes, less what the free columns take of it over the whole record."""
    rng = np.random.default_rng(5)
    n, out = 14, np.array([4, 5, 11])
    flat = np.column_stack([np.ones(n), np.arange(n) / n])
    columns, y = rng.standard_normal((n, 2)), np.cumsum(rng.standard_normal(n))
    walk = np.minimum.outer(np.arange(1.0, n + 1), np.arange(1.0, n + 1))
    parts = [
        Component("part", columns),
        Component("walk", covariance=walk),
        Component("white", covariance=np.eye(n)),
    ]
    variance = {"part": 0.7, "walk": 0.5, "white": 0.4}
    means = SimpleNamespace(set_index=np.arange(n), t_s=np.arange(n))
    model = SimpleNamespace(design=flat, flat=(0, 1), error_dps=y, all=parts, means=means)
    fitted = SimpleNamespace(fit=SimpleNamespace(variance=variance))
    found = leave_out(cast(Fitted, fitted), cast(Model, model), [out], {"walk", "white"})
    stays = 0.7 * columns @ columns.T + 1e5 * flat @ flat.T
    passes = 0.5 * walk + 0.4 * np.eye(n)
    rest = np.setdiff1d(np.arange(n), out)
    gain = np.linalg.inv((stays + passes)[np.ix_(rest, rest)])
    taken = flat @ np.linalg.pinv(flat)
    mean = passes[:, rest] @ gain @ y[rest]
    predicted = stays[np.ix_(out, rest)] @ gain @ y[rest] + (taken @ mean)[out]
    np.testing.assert_allclose(found.squares, (y[out] - predicted) ** 2, rtol=1e-3, atol=1e-6)
    # As it scatters over records that are made of the model.
    drawn = rng.multivariate_normal(np.zeros(n), 0.7 * columns @ columns.T + passes, 40_000)
    of_rest = stays[np.ix_(out, rest)] @ gain + (taken @ passes[:, rest])[out] @ gain
    errors = drawn[:, out] - drawn[:, rest] @ of_rest.T
    np.testing.assert_allclose(found.variance, errors.var(axis=0), rtol=0.05)


@pytest.mark.slow
def test_a_hidden_step_of_the_scale_factor_is_a_step_of_the_staircase(stepped: Diagnosis) -> None:
    assert [layer.name for layer in stepped.layers][:2] == ["", "scale_step"]
    surface, step = stepped.layers[:2]
    # Half of the record is off by up to half of the jump; the other half by the rest.
    rms_rate = float(np.sqrt(np.mean(plan(8)[1] ** 2)))
    assert surface.heldout_rms_dps == pytest.approx(STEP / 2 * rms_rate, rel=0.15)
    assert step.heldout_rms_dps < 1.3 * step.noise_floor_dps
    effect = next(e for e in stepped.effects if e.effect == "scale_step")
    assert effect.improvement is not None
    assert effect.improvement.interval_95[0] > 0
    assert "surface alone" in staircase_sentence(stepped) or len(stepped.layers) == 2
    assert layer_rows(stepped)[1][0] == "scale_step"


@pytest.mark.slow
def test_the_picture_says_what_each_step_adds(stepped: Diagnosis) -> None:
    axes = staircase_figure(stepped).axes[0]
    words = [label.get_text().replace("\n", "") for label in axes.get_xticklabels()]
    assert words[:2] == ["surfacealone", "scale_step"]


def test_the_picture_has_a_legend_and_no_number_of_a_bar_stands_over_the_line_of_the_noise() -> None:
    layers = (Layer("", 0.2, 0.1, 0.0), Layer("scale_step", 0.08, 0.1, 0.0), Layer("lag", 0.005, 0.1, 0.0))
    figure = staircase_figure(cast(Diagnosis, SimpleNamespace(layers=layers, effects=())))
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["what noise alone would leave"]
    numbers = [n for n in figure.axes[0].texts if isinstance(n, Annotation)]
    assert [n.xy[1] for n in numbers] == pytest.approx([200.0, 80.0, 5.0])
    assert [n.get_verticalalignment() for n in numbers] == ["bottom", "top", "bottom"]


@pytest.mark.slow
def test_named_effects_that_are_no_step_are_told_with_the_reason(stepped: Diagnosis) -> None:
    """Of five names two were missing from the table and picture, which said that a layer more is added at each step."""
    assert [e.effect for e in stepped.effects] == ["scale_step"]
    assert not_a_step(stepped) == ""
    own = stepped.effects[0]
    within = replace(own, effect="table_eccentricity", family="angle, with rate")
    ringing = replace(own, effect="step_response", family="step")
    stray = replace(
        own,
        effect="bursts",
        family="sampling",
        seen=Remark(Said.BURST_SAMPLES, {"count": 5, "samples": 3000}),
    )
    held = replace(own, effect="warm_up", family="time")
    more = replace(stepped, effects=(own, within, ringing, stray, held))
    assert not_a_step(more) == (
        "No steps of their own have table_eccentricity and step_response, found within data sets, whose means hardly show it; "
        "bursts, found in single samples or data sets; "
        "warm_up, which parts without a name stand for in the model that the steps are of."
    )
    assert not_a_step(replace(more, layers=())) == ""
    tables = {t.name: t for t in tables_of(more)}
    assert not_a_step(more) in tables["layers"].note
    captions = [p.caption for p, _ in figures(more) if p.name == "staircase"]
    assert not_a_step(more) in captions[0]


@pytest.mark.slow
def test_what_has_no_name_is_said_in_numbers(stepped: Diagnosis) -> None:
    part = UnnamedPart(
        "rate", "rate shape", 35.2, 0.012, 93.6, 100.8, "deg/s", {"saturation": 12.0}, corrected=True
    )
    found = Diagnosis(**{**vars(stepped), "unnamed": (part,)})
    assert unnamed_sentences(found) == [
        "Without a name: rate 93.6 to 100.8 deg/s (12 mdeg/s rms), more than 1,000,000 to 1 for it; nearest is saturation "
        "(takes 66 % of it). It is corrected."
    ]
    unknown = Layer("odd rate", 1e-3, 1e-3, 0.0)
    assert layer_rows(Diagnosis(**{**vars(stepped), "layers": (unknown,)}))[0][0] == "odd rate, no name"


@pytest.mark.slow
def test_a_nearest_law_takes_all_or_a_share_or_is_none(stepped: Diagnosis) -> None:
    """Beside the rest of a model it can leave more than there was, or less than nothing."""
    near = {"scale_step": -1.8, "rate_order": 4.0, "scale_drift": 240.0}
    part = UnnamedPart("time", "time", 8.0, 1e-3, None, None, "s", near, corrected=False)
    said = unnamed_sentences(Diagnosis(**{**vars(stepped), "unnamed": (part,)}))[0]
    assert "nearest are scale_step (takes all of it) and rate_order (takes 50 % of it). It" in said
    nothing = replace(part, nearest={"scale_drift": 240.0})
    said = unnamed_sentences(Diagnosis(**{**vars(stepped), "unnamed": (nothing,)}))[0]
    assert "; no law that was tried takes any of it. It" in said


def test_a_level_of_the_rate_is_a_place_by_itself() -> None:
    """Means of one commanded rate differ in the last digit."""
    rates = np.repeat(np.linspace(-60.0, 60.0, 7), 5) * (1.0 + 1e-15 * np.arange(35))
    which, low, high = binned(rates)
    assert np.array_equal(which, np.repeat(np.arange(7), 5))
    np.testing.assert_array_equal(low, high)
    many = np.random.default_rng(1).normal(size=1000)
    which, low, high = binned(many)
    assert np.all(low < high)
    assert np.all(np.diff(low) > 0)
    assert np.all((low[which] <= many) & (many <= high[which]))
