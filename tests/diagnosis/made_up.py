"""A diagnosis made from a concealed recording's own answer: what the page is tested with, without the finder."""

from __future__ import annotations

import numpy as np
from scipy import stats

from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import (
    Alternative,
    Diagnosis,
    Estimate,
    Improvement,
    Located,
    NamedEffect,
    NoiseFigures,
    Rows,
    Verdict,
)
from gyrocal.fusion.coefficients import Coefficients, Valid
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.surface import Surface
from tests.diagnosis.concealed_bench import Recording
from tests.diagnosis.concealed_world import STEP_S, Floats

#: Rows of a second: as the finder's bins.
_PER_BIN = 10


def _bins(recording: Recording, fine: Floats) -> Floats:
    w = recording.world
    return np.concatenate([fine[p.start : p.stop].reshape(-1, _PER_BIN).mean(axis=1) for p in w.pieces])


def _rows(recording: Recording) -> Rows:
    """Rows of a second, with the hidden effects known exactly and the surface known exactly."""
    w = recording.world
    number = np.repeat(np.arange(len(w.pieces)), [(p.stop - p.start) // _PER_BIN for p in w.pieces])
    rng = np.random.default_rng(recording.seed)
    noise = rng.normal(size=number.size) * recording.noise.white_dps
    noise += (rng.normal(size=len(w.pieces)) * recording.noise.floor_dps)[number]
    row_t = w.rows(w.t_s)
    effects = {
        h.effect: np.interp(_bins(recording, w.t_s), row_t, e)
        for h, e in zip(recording.hidden, recording.effect_dps, strict=True)
    }
    start = np.array([w.t_s[p.start] - STEP_S / 2 for p in w.pieces])
    t_s = _bins(recording, w.t_s)
    return Rows(
        t_s=t_s,
        rate_dps=_bins(recording, w.rate_dps),
        temp_c=_bins(recording, w.case_c),
        temp_rate_c_per_min=_bins(recording, np.gradient(w.case_c, STEP_S) * 60),
        set_index=number,
        is_set=np.array([p.kind == "rate" for p in w.pieces])[number],
        before_dps=noise + sum(effects.values()),
        after_dps=noise,
        white_std_dps=np.full(number.size, recording.noise.white_dps),
        angle_deg=_bins(recording, w.angle_deg),
        supply_v=_bins(recording, w.supply_v),
        since_power_on_s=t_s,
        since_set_s=t_s - start[number],
        step_dps=np.array([p.step_dps for p in w.pieces])[number],
        effect_dps=effects,
    )


def made_up_diagnosis(recording: Recording, verdict: Verdict = "explained") -> Diagnosis:
    """The true answer in the finder's form."""
    surface = Surface(np.full((4, 3), 0.01), 0.0, 100.0, 20.0, 30.0)
    model = Coefficients(
        {"model": "RD2100-class"}, surface, np.eye(12) * 1e-8, Valid((-100.0, 100.0), (-10.0, 50.0))
    )
    better = Improvement(
        2e-3, 1.2e-3, 1.1e-3, (5e-4, 9e-4), 1.5, 0.6, (0.5, 1.2), 0.9, Remark(Said.LEFT_OUT_SETS)
    )
    named = []
    for h in recording.hidden:
        effect = CATALOGUE[h.effect]
        sizes = {"amplitude": h.amplitude, **h.parameters}
        known = {p.name: p.unit for p in effect.parameters}
        parameters = {
            k: Estimate(v, abs(v) / 20, known[k], (v - abs(v) / 10, v + abs(v) / 10))
            for k, v in sizes.items()
            if k in known
        }
        others = tuple(Alternative(other, 4.0) for other in effect.looks_like[:1] if other in CATALOGUE)
        named.append(
            NamedEffect(
                h.effect,
                effect.family,
                parameters,
                float(stats.norm.sf(h.d_prime)),
                others,
                better,
                effect.runtime,
            )
        )
    return Diagnosis(
        recording="made-up",
        verdict=verdict if named else "consistent",
        located=tuple(Located(CATALOGUE[e.effect].seen_in, "mean", 1e-9, 0.8) for e in named),
        effects=tuple(named),
        not_testable={"acceleration": "the table's acceleration was not logged"},
        sentences=(),
        noise=NoiseFigures(1.4e-3, 0.083, 1.8, 2.0),
        improvement=better if named else None,
        surface=model,
        improved=model if named else None,
        rows=_rows(recording),
    )
