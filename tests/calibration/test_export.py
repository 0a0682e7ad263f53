"""The C header against Python, compiled by gcc as strictly as it goes."""

from __future__ import annotations

import json
import shutil
import struct
import subprocess
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from gyrocal.calibration.export import CType, export_c_header, power_of_two_surface
from gyrocal.calibration.export_terms import term_source
from gyrocal.cli import gyrocal_command
from gyrocal.errors import CoefficientError, InputError
from gyrocal.fusion import Coefficients, Compensator, Term, Valid
from gyrocal.physics.catalogue import CATALOGUE, find_effect
from gyrocal.physics.effect import Floats
from gyrocal.physics.shapes import DRIVERS, RATE, TEMPERATURE, Driver, Shape
from gyrocal.physics.smooth import Column, Factor, Frame, SmoothTerm
from gyrocal.physics.surface import Direction, Surface
from gyrocal.physics.terms import RuntimeTerm

GCC = shutil.which("gcc")
FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
POINTS = 10_000

MAIN = """
#include <stdio.h>
#include "fog.h"
int main(void)
{
    double p[2];
    while (fread(p, sizeof p, 1, stdin) == 1) {
        const float g = (float)p[0], t = (float)p[1];
        double out[6];
        out[0] = fog_error(p[0], p[1]);
        out[1] = fog_correct(p[0], p[1]);
        out[2] = fog_errorf(g, t);
        out[3] = fog_correctf(g, t);
        out[4] = fog_flags(p[0], p[1]);
        out[5] = fog_flagsf(g, t);
        fwrite(out, sizeof out, 1, stdout);
    }
    return 0;
}
"""


def rd2100(seed: int = 0, size: float = 1.0) -> Coefficients:
    """Surface of the class of the paper's Table I: 0.5 % nonlinearity, 2 % scale and 0.2 deg/s bias over temperature."""
    rng = np.random.default_rng(seed)
    spread = size * np.array([[0.1, 0.1, 0.05], [2.0, 1.0, 0.3], [0.3, 0.1, 0.05], [1.5, 0.3, 0.1]])
    surface = Surface(spread * rng.normal(size=(4, 3)), 1.7 * rng.normal(), 96.4, 21.3 + rng.normal(), 29.7)
    return Coefficients(
        {"model": "RD2100 */ /* ", "serial": "7"}, surface, np.eye(12), Valid((-100.0, 100.1), (-10.3, 50.0))
    )


def run_c(tmp_path: Path, coefficients: Coefficients, points: Floats, *flags: str) -> Floats:
    (tmp_path / "fog.h").write_text(export_c_header(coefficients, prefix="fog").text, encoding="utf-8")
    (tmp_path / "main.c").write_text(MAIN, encoding="utf-8")
    program = tmp_path / "program"
    subprocess.run([str(GCC), *FLAGS, *flags, "-o", program, tmp_path / "main.c"], check=True)
    out = subprocess.run([program], input=points.astype("<f8").tobytes(), stdout=subprocess.PIPE, check=True)
    return np.frombuffer(out.stdout, dtype=np.float64).reshape(-1, 6)


def random_points(seed: int) -> Floats:
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-100, 100.1, POINTS), rng.uniform(-10.3, 50, POINTS)])
    points[: POINTS // 2] = points[: POINTS // 2].astype(np.float32)
    return points


@pytest.mark.skipif(GCC is None, reason="gcc is absent")
@pytest.mark.parametrize(
    ("size", "flags"), [(1.0, ["-O0"]), (1.0, ["-O3", "-march=native", "-ffp-contract=fast"]), (5.0, ["-O2"])]
)
def test_c_equals_python(tmp_path: Path, size: float, flags: list[str]) -> None:
    c = rd2100(3, size)
    points = random_points(1)
    out = run_c(tmp_path, c, points, *flags)
    gyro, temp = points.T
    error = c.surface.error_dps(gyro, temp)
    assert np.abs(out[:, 0] - error).max() < 1e-13
    assert np.abs(out[:, 1] - c.correct(gyro, temp)).max() < 1e-13
    # The float functions see the rounded inputs; so must Python.
    gyro, temp = points.astype(np.float32).astype(np.float64).T
    error = c.surface.error_dps(gyro, temp)
    assert np.abs(error).max() > size
    worst = np.abs(out[:, 2] - error).max()
    assert worst <= 1e-6
    # Half a step of a float at the error's size and a little: nothing but the last rounding is left.
    assert np.all(np.abs(out[:, 2] - error) <= 0.51 * np.spacing(np.abs(error).astype(np.float32)))
    half_step = 0.5 * np.spacing(np.abs(gyro - error).astype(np.float32))
    assert np.all(np.abs(out[:, 3] - (gyro - error)) <= half_step + 1e-6)


@pytest.mark.skipif(GCC is None, reason="gcc is absent")
def test_flags(tmp_path: Path) -> None:
    c = rd2100()
    points = np.array(
        [[0, 20], [-100, -10.3], [-100.5, 20], [101, 60], [0, -11], [np.nan, 20], [5, np.nan], [np.inf, 20]]
    )
    out = run_c(tmp_path, c, points)
    np.testing.assert_array_equal(out[:, 4], c.flags(*points.T))
    np.testing.assert_array_equal(out[:, 5], c.flags(*points.T))


@pytest.mark.skipif(GCC is None, reason="gcc is absent")
@pytest.mark.parametrize("ctype", ["float", "double"])
def test_one_type_alone_compiles(tmp_path: Path, ctype: CType) -> None:
    export = export_c_header(rd2100(), ctype)
    suffix = "f" if ctype == "float" else ""
    assert export.functions == tuple(f"gyrocal_{name}{suffix}" for name in ("error", "correct", "flags"))
    (tmp_path / "h.h").write_text(export.text, encoding="utf-8")
    source = f'#include "h.h"\nint main(void) {{ return gyrocal_flags{suffix}(gyrocal_correct{suffix}(1, 2), 20); }}'
    (tmp_path / "m.c").write_text(source, encoding="utf-8")
    subprocess.run([str(GCC), *FLAGS, "-c", "-o", tmp_path / "m.o", tmp_path / "m.c"], check=True)


def test_power_of_two_surface_is_the_same_surface() -> None:
    surface = rd2100(5).surface
    same = power_of_two_surface(surface)
    assert struct.unpack("<I", struct.pack("<f", same.rate_scale_dps))[0] & 0x7FFFFF == 0
    gyro, temp = random_points(2).T
    np.testing.assert_allclose(same.error_dps(gyro, temp), surface.error_dps(gyro, temp), atol=1e-13)


TERMS_MAIN = """
#include <stdio.h>
#include "fog.h"
int main(void)
{
    double p[5];
    STATES
    while (fread(p, sizeof p, 1, stdin) == 1) {
        double out[2];
        out[0] = fog_error(ARGUMENTS);
        out[1] = fog_errorf(ARGUMENTSF);
        fwrite(out, sizeof out, 1, stdout);
    }
    return 0;
}
"""


def typical_term(effect_id: str, **values: float) -> Term:
    effect = find_effect(effect_id)
    # What scatters from visit to visit is no robot's: a file has the mean.
    still = {p.name: 0.0 for p in effect.parameters if p.name == "scatter"}
    parameters = effect.complete({**still, **values})
    entries: dict[str, Any] = {
        k: {"value": v, "std": 0.0, "unit": effect.parameter(k).unit} for k, v in parameters.items()
    }
    return Term(effect_id, entries, True)


def run_terms(tmp_path: Path, c: Coefficients, rows: Floats) -> Floats:
    export = export_c_header(c, prefix="fog")
    (tmp_path / "fog.h").write_text(export.text, encoding="utf-8")
    source = TERMS_MAIN.replace(
        "STATES", "fog_state s = {0}, sf = {0};" if "fog_state" in export.text else ""
    )
    for name, cast, state in (("ARGUMENTSF", "(float)", "&sf"), ("ARGUMENTS", "", "&s")):
        arguments = [f"{cast}p[1]", f"{cast}p[2]"]
        arguments = [state, f"{cast}p[0]", *arguments] if "fog_state" in export.text else arguments
        arguments += [f"{cast}p[3]"] if "double since_power_on_s" in export.text else []
        arguments += [f"{cast}p[4]"] if "double supply_v" in export.text else []
        source = source.replace(name, ", ".join(arguments))
    (tmp_path / "main.c").write_text(source, encoding="utf-8")
    program = tmp_path / "program"
    libm = ["-lm"] if "math.h" in export.text else []
    command: list[str | Path] = [str(GCC), *FLAGS, "-O2", "-o", program, tmp_path / "main.c", *libm]
    subprocess.run(command, check=True)
    out = subprocess.run([program], input=rows.astype("<f8").tobytes(), stdout=subprocess.PIPE, check=True)
    return np.frombuffer(out.stdout, dtype=np.float64).reshape(-1, 2)


RUNTIME = [effect.id for effect in CATALOGUE.values() if effect.runtime]
SETS = {effect_id: (typical_term(effect_id),) for effect_id in RUNTIME} | {
    "all": tuple(map(typical_term, RUNTIME)),
    "two lags": tuple(map(typical_term, ("thermal_lag", "shupe", "scale_asymmetry"))),
    "no state": tuple(map(typical_term, ("sagnac_sine", "temperature_order"))),
    "soft knee": (typical_term("saturation", knee_dps=60.0, softness_dps=2.5),),
    "soft sides": (typical_term("scale_asymmetry", softness_dps=8.0),),
    "cut by the sign of the output": (typical_term("truncation", of_output=1.0),),
    "peak without tails": (typical_term("mechanical_resonance", form=1.0),),
    "cut away from zero": (typical_term("truncation", amplitude=-40.0),),
    **{
        f"dead zone of the form {form:g}": (
            typical_term(
                "dead_zone",
                amplitude=900.0,
                width_dps=0.9,
                form=form,
                rest=0.5,
                place_dps=0.2 * (form == 3.0),
            ),
        )
        for form in (1.0, 2.0, 3.0)
    },
}


def assert_equal_in_c(tmp_path: Path, c: Coefficients, single: float) -> None:
    """Both C functions against the compensator, over the whole range; `single`: allowed in float, deg/s."""
    rows = random_rows(100.0)
    out, error = run_terms(tmp_path, c, rows), error_by_python(c, rows)
    np.testing.assert_array_equal(np.isnan(out[:, 0]), np.isnan(error))
    good = ~np.isnan(error)
    assert good.mean() > 0.9
    assert np.abs(out[good, 0] - error[good]).max() < 1e-10
    assert np.abs(out[good, 1] - error[good]).max() <= single


@pytest.mark.skipif(GCC is None, reason="gcc is absent")
@pytest.mark.parametrize("terms", SETS.values(), ids=list(SETS))
def test_terms_in_c_equal_the_compensator(tmp_path: Path, terms: tuple[Term, ...]) -> None:
    # Errors of 1.5 deg/s, as the paper's gyro has them: a float's digits are a share of the error.
    base = rd2100(3, 0.3)
    c = replace(base, terms=terms)
    assert_equal_in_c(tmp_path, c, single=1e-6)


def smooth_part() -> SmoothTerm:
    """Every shape of rate and temperature and every driver that a robot has, 10 mdeg/s each and of either sign."""
    numbers = {
        "order": 5.0, "center_dps": 40.0, "width_dps": 12.0, "center": 5.0, "width": 1.5, "center_c": 10.0,
        "width_c": 9.0, "tau_s": 300.0, "longer_tau_s": 600.0, "half_width_c": 4.0,
    }  # fmt: skip

    def factors(kinds: Mapping[str, Shape] | Mapping[str, Driver]) -> list[Factor]:
        return [Factor(kind, tuple(numbers[name] for name in of.names)) for kind, of in kinds.items()]

    columns = (
        *(Column(rate) for rate in factors(RATE)),
        *(Column(Factor("linear"), temperature) for temperature in factors(TEMPERATURE)),
        *(
            Column(Factor("legendre", (2.0,)), Factor("legendre", (1.0,)), driver)
            for driver in factors(DRIVERS)
        ),
    )
    p = len(columns)
    size = {"lag": 0.1, "band": 0.1, "temperature_rate": 10.0, "play": 0.3}
    b = [0.01 * (-1) ** k / size.get(column.driver.kind, 1.0) for k, column in enumerate(columns)]
    seen = np.tile([-9.0, 9.0], (p, 1))
    return SmoothTerm(
        "rate shape", "part", Frame(128.0, 20.0, 32.0, 12.0), columns, np.array(b), np.eye(p), seen
    )


def third_of_nonlinearity() -> Surface:
    a = np.array([[0.05, -0.02, 0.01], [0.4, 0.3, -0.1], [0.5, 0.1, 0.0], [-22.0, 0.5, 0.2]])
    return Surface(a, 0.5, 100.0, 20.0, 30.0, "input")


INVERSE = {
    "input, bare": ("input", ()),
    "output, smooth": ("output", ("smooth",)),
    "input, smooth": ("input", ("smooth",)),
    "input, all": ("input", ("smooth", *RUNTIME)),
}


@pytest.mark.skipif(GCC is None, reason="gcc is absent")
@pytest.mark.parametrize(("direction", "terms"), INVERSE.values(), ids=list(INVERSE))
def test_inverse_direction_and_terms_without_a_name_in_c(
    tmp_path: Path, direction: Direction, terms: tuple[str, ...]
) -> None:
    base = rd2100(3, 0.3)
    surface = replace(base.surface, direction=direction)
    c = replace(
        base, surface=surface, terms=tuple(smooth_part() if e == "smooth" else typical_term(e) for e in terms)
    )
    assert_equal_in_c(tmp_path, c, single=2e-6)


@pytest.mark.skipif(GCC is None, reason="gcc is absent")
@pytest.mark.parametrize("terms", [(), (smooth_part(),)], ids=["bare", "smooth"])
def test_an_open_loop_of_a_third_in_c(tmp_path: Path, terms: tuple[SmoothTerm, ...]) -> None:
    """Outputs to the end of the branch and beyond it: the same numbers, and no number in the same places."""
    surface = third_of_nonlinearity()
    c = replace(rd2100(), surface=surface, terms=terms)
    rows = random_rows(90.0)
    out, error = run_terms(tmp_path, c, rows), error_by_python(c, rows)
    np.testing.assert_array_equal(np.isnan(out[:, 0]), np.isnan(error))
    good = ~np.isnan(error)
    assert np.abs(error[good]).max() > 30.0
    assert 0.01 < np.mean(~good & np.isfinite(rows[:, 2])) < 0.2
    # A rounding of the output grows as the slope falls; where it has gone flat nothing is exact.
    rate = rows[good, 1] - error[good]
    slope = 1 + surface.slope_per_dps(rate, rows[good, 2])
    steep = slope > 0.2
    assert np.abs(out[good, 0] - error[good])[steep].max() < 1e-10
    assert np.abs(out[good, 1] - error[good])[steep].max() < 1e-4


def random_rows(largest_dps: float) -> Floats:
    """Rows of (dt, output, temperature, time since power-on, supply), in numbers that a float holds: both types see the same."""
    rng = np.random.default_rng(4)
    dt = rng.choice([0.0, 0.0078125, 0.125, 300.0], POINTS, p=[0.01, 0.5, 0.48, 0.01])
    dt[0] = 0.0
    t = np.cumsum(dt)
    gyro = rng.uniform(-largest_dps, largest_dps, POINTS)
    temp = 20 + 28 * np.sin(t / 700) + rng.normal(0, 0.01, POINTS)
    temp[rng.random(POINTS) < 0.01] = np.nan
    supply = np.where(rng.random(POINTS) < 0.1, np.nan, rng.uniform(11.0, 13.0, POINTS))
    return np.column_stack([dt, gyro, temp, t + 64.0, supply]).astype(np.float32).astype(np.float64)


def error_by_python(c: Coefficients, rows: Floats) -> Floats:
    dt, gyro, temp, *more = rows.T
    return np.asarray(gyro - Compensator(c).correct(np.cumsum(dt), gyro, temp, *more))


def test_terms_that_cannot_be_exported_and_bad_prefixes_are_refused() -> None:
    c = rd2100()
    with pytest.raises(CoefficientError, match="magnetic is marked runtime, and a robot cannot evaluate it"):
        export_c_header(replace(c, terms=(Term("magnetic", {}, True),)))
    novel = replace(find_effect("shupe"), id="novel", c_text=None)
    with pytest.raises(
        CoefficientError, match=r"hold the term novel, which cannot be written in C.*Compensator"
    ):
        term_source(c.surface, (RuntimeTerm(novel, novel.typical(), 0.0),), repr, "double")
    with pytest.raises(InputError, match="a C identifier"):
        export_c_header(c, prefix="my gyro")


def test_the_command(tmp_path: Path) -> None:
    c = rd2100()
    source, header = tmp_path / "c.json", tmp_path / "c.h"
    eccentric = Term("table_eccentricity", {"amplitude": {"value": 1.0}}, False)
    c = replace(c, terms=(eccentric, typical_term("shupe")))
    source.write_text(c.to_text(), encoding="utf-8")
    run = CliRunner()
    said = run.invoke(gyrocal_command, ["export", str(source), "-o", str(header)], catch_exceptions=False)
    assert "gyrocal_error, gyrocal_correct, gyrocal_flags, gyrocal_errorf" in said.stdout
    assert "not exported: table_eccentricity" in said.stdout
    assert "Terms beside the surface: shupe." in said.stdout
    text = run.invoke(gyrocal_command, ["export", str(source)], catch_exceptions=False).stdout
    assert text == header.read_text(encoding="utf-8")
    digest = json.loads(source.read_text(encoding="utf-8"))["sha256"]
    assert digest in text
    assert "@" not in text
    assert '"model": "RD2100 * / / * "' in text
    again = ["export", str(source), "-o", str(header), "--json"]
    header.write_text("mine", encoding="utf-8")
    assert "exists; nothing was overwritten" in str(run.invoke(gyrocal_command, again).exception)
    assert header.read_text(encoding="utf-8") == "mine"
    facts = run.invoke(gyrocal_command, [*again, "--overwrite"]).stdout
    assert header.read_text(encoding="utf-8") == text
    assert json.loads(facts)["coefficients_sha256"] == digest
    assert run.invoke(gyrocal_command, ["export", str(source), "--json"]).exit_code == 2
    wrong = run.invoke(gyrocal_command, ["export", str(source), "--prefix", "1 bad"])
    assert wrong.exit_code == 2
    assert "Invalid value for '--prefix': the prefix is '1 bad'; a C identifier" in wrong.output
    onto_itself = run.invoke(gyrocal_command, ["export", str(source), "-o", str(source), "--overwrite"])
    assert "is an input of this command" in str(onto_itself.exception)
    assert source.read_text(encoding="utf-8").startswith("{")
