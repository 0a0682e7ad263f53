"""A calibration in words, tables and plain data: what `gyrocal fit` prints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from gyrocal.calibration.calibrate import Calibration
from gyrocal.calibration.choice import PAPER
from gyrocal.calibration.figure import Figure, bound_said, number, value_said
from gyrocal.calibration.fit import rms
from gyrocal.physics.surface import SHAPE
from gyrocal.records.scale import stray_rows
from gyrocal.units import DPS_TO_DPH, MDPS, NORMAL_95, PPM, S_PER_H, decimals, dph, p_equals, plural

#: A |rate| whose scatter differs from the trend at this level is worth a line.
_ODD = 0.01
_LISTED = 12
#: A surface that makes the error smaller by less does not follow what is wrong; then up to this share of the data sets may be off.
_NO_HELP, _MOST_STRAY = 2.0, 0.4

#: What the residual is tested for structure over, in words.
STRUCTURE_WORDS = {
    "rate": "rate",
    "temperature": "temperature",
    "time": "time",
    "data_set_index": "order of the data sets",
    "neighbours": "neighbouring data sets",
}


#: A residual that chance makes as small with less probability than this lies below a noise that is stated wrongly.
_NEVER = 1e-6
#: More than this times the sample noise is much to be left: what drifts from data set to data set is mostly less.
_MUCH = 3.0

#: What is taken off an error before calibration, which any user of a gyro does without one.
ABOUT_LINE = "the best scale factor and bias"


@dataclass(frozen=True)
class Table:
    """A table of ready-made cells."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def verdict(c: Calibration) -> str:
    """One line: error before and after, factor, noise floor, whether the residual is structured."""
    floor = (
        "sample noise unknown"
        if c.sample_floor_dps is None
        else f"sample noise {dph(c.sample_floor_dps)} deg/h"
    )
    what, about = ("bias over temperature", "its mean") if c.config.bias_only else ("error", ABOUT_LINE)
    return (
        f"{what} {dph(c.before_dps)} (about {about}) -> {dph(c.after_dps)} deg/h rms, {_times(c.factor)}; "
        f"{floor}; {_structure_part(c)}{_outlier_part(c)}{_stray_part(c)}"
    )


def _structure_part(c: Calibration) -> str:
    if not c.structure:
        return "too few data sets to test the residual for structure"
    worst = p_equals(min(t.p_holm for t in c.structure))
    if c.structured:
        return f"the residual is structured in {', '.join(STRUCTURE_WORDS[name] for name in c.structured)} ({worst})"
    over = ", ".join(STRUCTURE_WORDS[t.coordinate] for t in c.structure)
    return f"no structure in the residual over {over} (smallest {worst}){_beyond_noise(c)}"


def _beyond_noise(c: Calibration) -> str:
    """How much more is left than the samples scatter by, where it is much: an order that no test here knows may be in it."""
    if c.sample_floor_dps is None or not c.sample_floor_dps > 0.0:
        return ""
    times = c.after_dps / c.sample_floor_dps
    return (
        f", but it is {times:.3g} times the sample noise: `gyrocal diagnose` looks what it is"
        if times > _MUCH
        else ""
    )


def _times(factor: float) -> str:
    return f"{factor:.3g} times smaller" if factor >= 1.0 else f"{1.0 / factor:.3g} times larger"


def _outlier_part(c: Calibration) -> str:
    """One data set that is far off makes up most of the scatter, and of the intervals, of all."""
    if not c.outliers:
        return ""
    ids = ",".join(str(o.segment) for o in c.outliers)
    sigmas = f"{'up to ' if len(c.outliers) > 1 else ''}{max(abs(o.sigmas) for o in c.outliers):.0f} sigma"
    which = plural(len(c.outliers), f"data set {ids} [is an outlier|are outliers]")
    return f"; {which} ({sigmas}), which scatter and intervals follow: see what --exclude {ids} changes"


def _stray_part(c: Calibration) -> str:
    """Data sets that were mixed up: what they are off by goes into the surface, and spoils it at every rate."""
    sets = c.fit.sets
    most = {"most": _MOST_STRAY} if c.factor < _NO_HELP else {}
    stray = stray_rows(sets.rate_dps, sets.gyro_dps, **most)
    if c.config.bias_only or not stray.size:
        return ""
    listed = "; ".join(sets.describe(row) for row in stray[:_LISTED]) + (
        "; ..." if stray.size > _LISTED else ""
    )
    ids = ",".join(str(sets.segment[row]) for row in stray)
    far = plural(stray.size, f"{stray.size} of {len(sets)} data sets [is|are] far off the line of the others")
    return (
        f". Do not use it: {far} ({listed}). Look whether rows were swapped, or the sign or unit of some is another, and "
        f"repair them or leave them out with --exclude {ids}"
    )


def remarks(c: Calibration) -> tuple[str, ...]:
    """Sentences beside the verdict: weights, scatter, outliers, noise, notes."""
    lines = [
        _choice_line(c),
        *_undetermined_line(c),
        _scatter_line(c),
        *_stated_noise_line(c),
        *_rest_line(c),
    ]
    lines += _odd_rates(c)
    lines.append(
        f"{len(c.outliers)} {plural(len(c.outliers), '[outlier|outliers]')}, listed and kept in the fit (leave out with --exclude)"
        if c.outliers
        else "no outliers"
    )
    if c.excluded_by_user:
        lines.append(f"left out by --exclude: {', '.join(map(str, c.excluded_by_user))}")
    lines.append(f"bias instability: {c.noise.statement}")
    lines += [f"Allan deviation: {c.noise.fit_statement}"] if c.noise.fit_statement else []
    valid = c.coefficients.valid
    lines.append(
        f"valid from {valid.rate_dps[0]:+.4g} to {valid.rate_dps[1]:+.4g} deg/s and "
        f"{valid.temp_c[0]:.1f} to {valid.temp_c[1]:.1f} °C; the runtime flags what is outside"
    )
    return (*lines, *_without_number(c), *c.notes)


def _choice_line(c: Calibration) -> str:
    paper = next((x for x in c.choice.candidates if x.model == PAPER), None)
    if paper is None or c.choice.model == PAPER:
        return c.choice.reason
    return f"{c.choice.reason}; --paper keeps the paper's"


def _undetermined_line(c: Calibration) -> list[str]:
    """Where the coefficients say little beyond what was visited."""
    if c.fit.terms.all() or c.config.bias_only:
        return []
    valid = c.coefficients.valid
    g, t = (a.ravel() for a in np.meshgrid(np.linspace(*valid.rate_dps, 9), np.linspace(*valid.temp_c, 9)))
    sigma = c.coefficients.sigma_dps(g, t)
    k = int(np.argmax(sigma))
    count = int((~c.fit.terms).sum())
    undetermined = plural(count, f"{count} [term|terms]")
    return [
        f"{undetermined} that the recording does not determine {plural(count, '[is|are]')} nothing in the surface and something "
        f"in its band: ± {dph(NORMAL_95 * float(sigma[k]))} deg/h (95 %) at {g[k]:+.4g} deg/s and {t[k]:.1f} °C, where it is widest"
    ]


def _scatter_line(c: Calibration) -> str:
    s = c.fit.scatter
    whats = (
        ("deg/h independent", DPS_TO_DPH),
        (f"deg/h of bias drift a decade of {'time' if s.timed else 'data sets'}", DPS_TO_DPH),
        ("ppm of the rate", 1.0 / PPM),
        ("deg/h/√h of random walk of the bias", DPS_TO_DPH * np.sqrt(S_PER_H))
        if s.timed
        else ("deg/h of random walk of the bias from one data set to the next", DPS_TO_DPH),
    )
    seen, bounds = [], []
    for (what, unit), level, upper, there in zip(whats, s.levels, s.upper, s.seen, strict=True):
        if there:
            seen.append(f"{np.sqrt(level) * unit:.3g} {what}")
        elif upper > 0:
            bounds.append(f"{np.sqrt(upper) * unit:.3g} {what}")
    unseen = f"; not seen, and less than this with 95 %: {', '.join(bounds)}" if bounds else ""
    at_rest = c.noise.figures.get("rate_random_walk")
    # Two numbers of one thing stand in what is printed: a reader must know why they differ.
    both = at_rest is not None and at_rest.high is not None and s.timed and s.upper[-1] > 0
    why = (
        "; the rate random walk among the figures is what the samples at rest say by themselves, within the averaging times "
        "of a rest, and this random walk what all data sets say, over the whole recording"
    )
    return f"scatter of the data sets beyond sample noise: {', '.join(seen) or 'none seen'}{unseen}{why if both else ''}"


def _stated_noise_line(c: Calibration) -> list[str]:
    """That a stated sample noise is larger than what is left, where it is by more than chance makes it."""
    floor_dps, left_dps = c.sample_floor_dps, c.fit.residual_dps
    freedom = left_dps.size - int(c.fit.terms.sum())
    if floor_dps is None or not floor_dps > 0.0 or freedom < 1:
        return []
    if np.sum(left_dps**2) >= chi2.ppf(_NEVER, freedom) * floor_dps**2:
        return []
    return [
        f"the sample noise that the recording states is {floor_dps / rms(left_dps):.3g} times what the fit leaves, and all "
        "intervals are as much too wide: check the unit of gyro_std_dps, and that n counts its samples"
    ]


def _rest_line(c: Calibration) -> list[str]:
    """Where the level of drift comes from."""
    s = c.fit.scatter
    if s.rest_disagrees:
        return [
            "the bias drifts more between data sets than at rest: the intervals rest on the data sets alone, "
            "and something other than 1/f noise and a walk may be at work (gyrocal diagnose)"
        ]
    if s.rest is None:
        return []
    return [
        f"the level of drift rests on {s.rest.span_s / 60:.0f} min at rest too ({s.rest.records} records)"
    ]


def _odd_rates(c: Calibration) -> list[str]:
    by_rate = c.scatter_by_rate
    if by_rate is None:
        return []
    lines = []
    if by_rate.growth_p_value < _ODD:
        lines.append(f"the scatter grows with |rate| ({p_equals(by_rate.growth_p_value)})")
    for k in np.flatnonzero(by_rate.p_value < _ODD):
        more = by_rate.neighbours[k] > 1
        lines.append(
            f"data sets at |rate| {by_rate.rate_dps[k]:.4g} deg/s scatter {by_rate.neighbours[k]:.2g} times as much as "
            f"at the neighbouring rates ({dph(by_rate.std_dps[k])} deg/h, {p_equals(float(by_rate.p_value[k]))}): "
            f"{'look for resonance, table or mount' if more else 'look for a dead band or clipping'} there"
        )
    return lines


def tables(c: Calibration) -> tuple[Table, ...]:
    """Coefficients, figures, cross-validation, structure and outliers."""
    made = [_coefficient_table(c), _figure_table(c), _left_out_table(c), _structure_table(c)]
    return (*made, _outlier_table(c)) if c.outliers else tuple(made)


def _coefficient_table(c: Calibration) -> Table:
    s = c.fit.surface
    half = c.fit.half_width_dps()
    shown = c.fit.terms
    places = {ij: max(decimals(float(half[ij]) / MDPS), 0) for ij in np.ndindex(SHAPE)}
    rows = tuple(
        (
            f"u^{i} v^{j}",
            f"{s.coefficients_dps[i, j] / MDPS:+.{places[i, j]}f}",
            f"{c.fit.std_dps[i, j] / MDPS:.{places[i, j]}f}",
            f"{half[i, j] / MDPS:.{places[i, j]}f}",
        )
        for i, j in np.ndindex(SHAPE)
        if shown[i * SHAPE[1] + j]
    )
    what = "gyro" if s.direction == "output" else "true rate"
    title = (
        f"Error in mdeg/s: u = ({what} {-s.rate_center_dps:+.6g}) / {s.rate_scale_dps:.6g} deg/s, "
        f"v = (temperature {-s.temp_center_c:+.6g}) / {s.temp_scale_c:.6g} °C"
    )
    return Table(title, ("term", "coefficient", "std. error", "± 95 %"), rows)


def _figure_table(c: Calibration) -> Table:
    """Figures before and after compensation; those without a number are told with their reason, among the remarks."""
    rows = [_figure_row(pair.before, pair.after) for pair in c.merit.values()]
    rows += [_figure_row(figure, None) for figure in c.noise.figures.values()]
    rows = [row for row in rows if row[1:3] != ("-", "-")]
    return Table(
        "Figures (named after IEEE 952), with 95 % intervals; after: on data left out",
        ("figure", "before", "after", "unit"),
        tuple(rows),
    )


def _figure_row(before: Figure, after: Figure | None) -> tuple[str, ...]:
    """Name, before, after, unit; noise is the same before and after."""
    first = said(before)
    same = "-" if first == "-" else "the same"
    return before.title, first, same if after is None else said(after), before.unit


def _without_number(c: Calibration) -> list[str]:
    """Figures without a number, by the reason that they have in common."""
    listed = [pair.before for pair in c.merit.values()] + list(c.noise.figures.values())
    by_reason: dict[str, list[str]] = {}
    for figure in listed:
        if figure.value is None:
            by_reason.setdefault(figure.reason, []).append(figure.title)
    return [f"no number for {', '.join(titles)}: {reason}" for reason, titles in by_reason.items()]


def said(figure: Figure) -> str:
    """Value and interval, a bound, or a dash."""
    if figure.interval is not None:
        value, low, high = figure.interval
        return number(value) if low == high else value_said(value, low, high)
    return "-" if figure.high is None else bound_said(figure.high)


def _left_out_table(c: Calibration) -> Table:
    equal = {v.left_out: v for v in c.cross_validation_ols}
    names = {"temperature": "whole temperatures", "rate": "whole rates", "time": "twelfths in time order"}
    rows = tuple(
        (
            names[v.left_out],
            str(v.folds),
            dph(v.rms_dps) if v.rms_dps is not None else "too few levels",
            dph(equal[v.left_out].rms_dps) if equal[v.left_out].rms_dps is not None else "too few levels",
        )
        for v in c.cross_validation
    )
    return Table(
        "Cross-validation: error on what was left out, deg/h rms",
        ("left out", "folds", "fit", "equal weights"),
        rows,
    )


def _structure_table(c: Calibration) -> Table:
    rows = tuple(
        (
            STRUCTURE_WORDS[t.coordinate],
            f"{t.statistic:.3g}",
            str(t.dof),
            f"{t.p_holm:.2g}",
            "yes" if t.structured else "no",
        )
        for t in c.structure
    )
    return Table(
        "Structure of the residual (1 % false alarms)",
        ("in", "statistic", "dof", "p (Holm)", "structured"),
        rows,
    )


def _outlier_table(c: Calibration) -> Table:
    rows = tuple(
        (
            str(o.segment),
            f"{o.rate_dps:+.4g}",
            f"{o.temp_c:.1f}",
            dph(o.residual_dps),
            f"{o.sigmas:+.1f}",
            o.reason,
        )
        for o in c.outliers[:_LISTED]
    )
    more = f" (the first {_LISTED} of {len(c.outliers)})" if len(c.outliers) > _LISTED else ""
    return Table(f"Outliers{more}", ("data set", "deg/s", "°C", "off by deg/h", "sigma", "reason"), rows)


def to_json(c: Calibration) -> dict[str, Any]:
    """Plain data of the result for ``--json``."""
    file = c.coefficients
    return {
        "verdict": verdict(c),
        "remarks": list(remarks(c)),
        "chosen": c.choice.reason,
        "candidates": [
            {
                "direction": x.model.direction,
                "temperature_orders": list(x.model.orders),
                "left_out_rms_dps": x.left_out_rms_dps,
            }
            for x in c.choice.candidates
        ],
        "factor": c.factor,
        "structured_in": list(c.structured),
        "figures": dict(file.figures),
        "coefficients_dps": file.surface.coefficients_dps.tolist(),
        "half_width_95_dps": c.fit.half_width_dps().tolist(),
        "valid": {"rate_dps": list(file.valid.rate_dps), "temp_c": list(file.valid.temp_c)},
        "noise": {
            "angle_random_walk_deg_per_rt_h": c.noise.angle_random_walk_deg_per_rt_h,
            "bias_instability_deg_per_h": c.noise.bias_instability_deg_per_h,
            "bias_instability": c.noise.statement,
        },
        "outliers": [
            {
                "data_set": o.segment,
                "rate_dps": o.rate_dps,
                "temp_c": o.temp_c,
                "residual_dps": o.residual_dps,
                "p_value": o.p_value,
                "reason": o.reason,
            }
            for o in c.outliers
        ],
        "provenance": dict(file.provenance),
    }
