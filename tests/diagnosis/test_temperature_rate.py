"""What follows the rate of the temperature follows it at once, however late a robot knows it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.units import S_PER_MIN
from tests.calibration.runs import Part, gyro_row, write_run

_RAMP_C_PER_MIN, _CASE_S, _SOAK_S, _SET_S = 3.0, 60.0, 600.0, 20.0
_RATES_DPS = (0.0, 25.0, -25.0, 60.0, -60.0, 100.0, -100.0)


def bench(path: Path, shupe_mdps_per_c_per_min: float, seed: int) -> Path:
    """A gyro whose case follows a chamber with 60 s, whose ramps begin and end at once; a sample a second."""
    rng = np.random.default_rng(seed)
    parts: list[Part] = []
    t_s, air_c, case_c = 0.0, 23.0, 23.0

    def record(kind: str, rate_dps: float, to_c: float, duration_s: float) -> None:
        nonlocal t_s, air_c, case_c
        since_s = np.arange(1.0, duration_s + 1.0)
        pull = (to_c - air_c) / duration_s
        # The exact response of a case behind a straight ramp.
        behind_c = pull * _CASE_S + (air_c - case_c - pull * _CASE_S) * np.exp(-since_s / _CASE_S)
        course_c, slope = air_c + pull * since_s - behind_c, behind_c / _CASE_S * S_PER_MIN
        u, v = rate_dps / 100.0, (course_c - 20.0) / 30.0
        error = (
            0.02 + 0.05 * v + (0.08 - 0.03 * v) * u + 0.03 * u**3 + 1e-3 * shupe_mdps_per_c_per_min * slope
        )
        output = rate_dps + error + 1.4e-3 * rng.standard_normal(since_s.size)
        read_c = course_c + 0.003 * rng.standard_normal(since_s.size)
        rows = [
            gyro_row(t_s + s, f"{w:.7f}", f"{c:.3f}") for s, w, c in zip(since_s, output, read_c, strict=True)
        ]
        parts.append(Part(rows, rate_dps, to_c, kind, averaging_s=1.0))
        t_s, air_c, case_c = t_s + duration_s, to_c, float(course_c[-1])

    for at_c in (-10.0, 50.0, 20.0, 35.0, 5.0):
        record("ramp", 0.0, at_c, abs(at_c - air_c) / _RAMP_C_PER_MIN * S_PER_MIN)
        record("soak", 0.0, at_c, _SOAK_S)
        for rate_dps in _RATES_DPS:
            record("rate", rate_dps, at_c, _SET_S)
    return write_run(path, parts)


@pytest.mark.parametrize(("true", "seed"), [(3.0, 1), (-2.0, 2)])
def test_a_shupe_effect_has_its_size_where_ramps_begin_and_end_at_once(
    tmp_path: Path, true: float, seed: int
) -> None:
    """By a rate that was low-passed over 30 s it had 2.5 times its size, beside a lag and a step that are not there."""
    found = diagnose(bench(tmp_path / "run", true, seed), options=Options(heldout=False))
    (named,) = found.effects
    assert named.effect == "shupe"
    amplitude = named.parameters["amplitude"]
    assert amplitude.value == pytest.approx(true, rel=0.05)
    assert amplitude.interval_95[0] < true < amplitude.interval_95[1]
    # A robot follows the temperature with 30 s: what that leaves of the law is said.
    rows = found.rows
    assert rows is not None
    fine_s = np.arange(rows.t_s[0], rows.t_s[-1], 1.0)
    course_c = np.interp(fine_s, rows.t_s, rows.temp_c)
    followed_c = lfilter(
        [1.0], [1.0, -np.exp(-1.0 / 30.0)], (1.0 - np.exp(-1.0 / 30.0)) * (course_c - course_c[0])
    )
    behind_c = np.interp(rows.t_s, fine_s, course_c - course_c[0] - followed_c)
    late_dps = 1e-3 * amplitude.value * (rows.temp_rate_c_per_min - S_PER_MIN * behind_c / 30.0)
    (note,) = (n for n in found.notes if isinstance(n, Remark) and n.said is Said.LATER_ON_A_ROBOT)
    assert note.facts["effects"] == ["shupe"]
    assert note.facts["late_dps"] == pytest.approx(np.sqrt(np.mean(late_dps**2)), rel=0.15)
