"""A bad profile is refused with the key, the value and what is allowed; a good one is read as it stands."""

from __future__ import annotations

import contextlib
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrocal.bench.plan import temperature_visits
from gyrocal.bench.profile import load_profile, parse_profile, profile_from_dict, shipped_profiles
from gyrocal.errors import InputError, ProfileError
from tests.bench.tiny import tiny, tiny_profile

TODAY = date(2026, 1, 1)


def refusal(**changes: Any) -> str:
    """The sentence that refuses the tiny profile with these changes."""
    with pytest.raises(ProfileError) as caught:
        profile_from_dict(tiny(**changes), "p.toml")
    return str(caught.value)


BAD: list[tuple[dict[str, Any], str]] = [
    ({"title": 7}, "p.toml: title is 7, and allowed is a text."),
    ({"title": None}, "p.toml: title is missing; it wants a text."),
    ({"soak__window_c": -1.0}, "p.toml: soak.window_c is -1.0, and allowed is a number from 0.01 to 20 deg C."),
    ({"soak__window_c": float("nan")}, "p.toml: soak.window_c is nan, and allowed is a number from 0.01 to 20 deg C."),
    ({"soak__window_c": True}, "p.toml: soak.window_c is true, and allowed is a number from 0.01 to 20 deg C."),
    ({"soak__window_c": "0.5"}, 'p.toml: soak.window_c is "0.5", and allowed is a number from 0.01 to 20 deg C.'),
    (
        {"settle__on_deadline": "ignore"},
        'p.toml: settle.on_deadline is "ignore", and allowed is one of "unsettled", "fail".',
    ),
    ({"plan__seed": 1.5}, f"p.toml: plan.seed is 1.5, and allowed is a whole number from 0 to {2.0**63:g}."),
    ({"plan__both_signs": 1}, "p.toml: plan.both_signs is 1, and allowed is true or false."),
    (
        {"sensor__rate_range_dps": [-1.0]},
        "p.toml: sensor.rate_range_dps is [-1.0], and allowed is a list of 2 numbers from -10000 to 10000 deg/s.",
    ),
    (
        {"plan__rates_dps": [1.0, "x"]},
        'p.toml: plan.rates_dps is "x", and allowed is a list of numbers from -10000 to 10000 deg/s (in the list).',
    ),
    (
        {"plan__rates_dps": 5.0},
        "p.toml: plan.rates_dps is 5.0, and allowed is a list of numbers from -10000 to 10000 deg/s.",
    ),
    ({"soak": 3}, "p.toml: soak is 3, and allowed is a table of keys."),
    (
        {"sensor__temp_range_c": [75.0, -40.0]},
        "p.toml: sensor.temp_range_c is [75.0, -40.0], and allowed is the lower number first.",
    ),
    ({"plan__temperatures_c": []}, "p.toml: plan.temperatures_c is [], and allowed is at least one temperature."),
    (
        {"plan__rates_dps": [-30.0]},
        "p.toml: plan.rates_dps is [-30.0], and allowed is positive numbers while both_signs is true.",
    ),
    (
        {"plan__temperatures_c": [20.0, 20.0]},
        'p.toml: plan.temperatures_c is [20.0, 20.0], and allowed is each value once, unless its order is "listed" '
        "(up repeats by itself).",
    ),
    (
        {"plan__static_s": 5.0, "plan__static_at_c": [21.0]},
        "p.toml: plan.static_at_c is 21.0, and allowed is temperatures that stand in plan.temperatures_c.",
    ),
    (
        {"plan__static_at_c": [20.0]},
        "p.toml: plan.static_s is 0.0, and allowed is more than 0 s where plan.static_at_c is given.",
    ),
    ({"sensor__model": ""}, 'p.toml: sensor.model is "", and allowed is a text that is not empty.'),
    ({"sensor__serial": ""}, 'p.toml: sensor.serial is "", and allowed is a text that is not empty.'),
    ({"title": ""}, 'p.toml: title is "", and allowed is a text that is not empty.'),
    ({"plan__ramp_rates_dps": []}, "p.toml: plan.ramp_rates_dps is [], and allowed is at least one rate; [0] keeps the table at rest."),
    ({"soak__deadline_s": 20.0}, "p.toml: soak.deadline_s is 20.0, and allowed is more than soak.time_s (20 s)."),
    ({"soak__slope_over_s": 60.0}, "p.toml: soak.slope_over_s is 60.0, and allowed is at most soak.time_s (20 s)."),
    ({"settle__hold_s": 10.0}, "p.toml: settle.deadline_s is 10.0, and allowed is more than settle.hold_s (10 s)."),
    ({"record__averaging_s": 0.05}, "p.toml: record.averaging_s is 0.05, and allowed is at least one sample (0.1 s)."),
    (
        {"virtual__effects": {"shupe": {"amplitude": 1e9}}},
        "p.toml: virtual.effects.shupe.amplitude is 1000000000.0, and allowed is a number from -1000 to 1000 mdeg/s per "
        "degC/min.",
    ),
    (
        {"virtual__effects": {"shupe": 3.0}},
        "p.toml: virtual.effects.shupe is 3.0, and allowed is a table of its parameters, {} for their usual sizes.",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "sentence"), BAD)
def test_bad_values_are_refused_with_key_value_and_what_is_allowed(
    changes: dict[str, Any], sentence: str
) -> None:
    assert refusal(**changes) == sentence


def test_unknown_keys_are_refused_with_the_nearest_known_one() -> None:
    assert refusal(soak__windw_c=0.5).startswith(
        "p.toml: soak.windw_c is an unknown key. Did you mean window_c? Known in [soak]: deadline_s, "
    )
    assert refusal(sok={}).startswith(
        "p.toml: sok is an unknown key. Did you mean soak? Known in the top level: bench, "
    )
    assert "shupe" in refusal(virtual__effects={"shup": {}})
    assert refusal(virtual__effects={"shupe": {"k": 1.0}}) == (
        "p.toml: virtual.effects.shupe.k is an unknown key. Known in [virtual.effects.shupe]: amplitude."
    )
    several = refusal(virtual__effects={"shup": {}, "shupe": 3.0}, plan__temperatures_c=[])
    assert several.count("p.toml: ") == 3
    # neither of the two fields that the program itself fills in is a key
    assert "unknown key" in refusal(source="x")


def test_text_that_is_not_toml_is_refused_with_its_line() -> None:
    with pytest.raises(ProfileError, match=r"^p\.toml: is not TOML: .*line 2.* Correct that line\.$"):
        parse_profile("title = 'x'\nsensor =\n", "p.toml")


def test_missing_profile_names_the_shipped_ones() -> None:
    with pytest.raises(ProfileError) as caught:
        load_profile("quik")
    assert str(caught.value) == (
        "quik: no such profile. Give the path of a .toml file or one of: quick, rd2100, scale_factor, static_allan, "
        "thermal_ramp."
    )
    with pytest.raises(ProfileError, match="no such profile"):
        load_profile("elsewhere/quick.toml")


def test_binary_profile_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="is not a text file"):
        load_profile(path)


@pytest.mark.parametrize("name", ["quick", "rd2100", "scale_factor", "static_allan", "thermal_ramp"])
def test_shipped_profiles_load_by_name_and_by_file_name(name: str) -> None:
    assert set(shipped_profiles()) == {"quick", "rd2100", "scale_factor", "static_allan", "thermal_ramp"}
    profile = load_profile(name)
    assert profile == load_profile(f"{name}.toml")
    assert profile.sha256 == load_profile(shipped_profiles()[name]).sha256
    assert profile.plan.temperature_order in ("interleaved", "up_down", "listed")


def test_rd2100_is_the_papers_range() -> None:
    profile = load_profile("rd2100")
    assert max(profile.plan.rates_dps) == 100.0
    assert profile.plan.both_signs
    visits = temperature_visits(profile.plan)
    assert visits == [-10, 0, 10, 20, 30, 40, 50, 40, 30, 20, 10, 0, -10]


def test_effects_get_their_usual_sizes_for_what_is_not_said() -> None:
    profile = tiny_profile(virtual__effects={"warm_up": {"amplitude": 7.0}, "shupe": {}})
    assert profile.virtual.effects["warm_up"] == {"amplitude": 7.0, "tau_s": 1200.0, "of_scale": 0.0}
    assert profile.virtual.effects["shupe"] == {"amplitude": 3.0}


def test_a_plan_without_rates_is_noted() -> None:
    assert profile_from_dict(tiny(), "p.toml").notes(TODAY) == ()
    (note,) = profile_from_dict(tiny(plan__rates_dps=[]), "p.toml").notes(TODAY)
    assert note.startswith("p.toml: plan.rates_dps is empty, so that no data set is at rate")


def test_digest_counts_values_not_comments_or_order() -> None:
    a = parse_profile(_toml("[settle]\nhold_s = 1.0\n[soak]\ntime_s = 400.0"), "a")
    b = parse_profile(_toml("# other words\n[soak]\ntime_s = 400.0\n[settle]\nhold_s = 1.0"), "b")
    c = parse_profile(_toml("[settle]\nhold_s = 1.5\n[soak]\ntime_s = 400.0"), "c")
    assert a.sha256 == b.sha256
    assert a.sha256 != c.sha256
    assert a.with_seed(5).sha256 != a.sha256
    assert a.with_seed(5).virtual.seed == 5
    assert a.with_seed(5).source == "a"


def _toml(rest: str) -> str:
    return (
        "title = 't'\n[sensor]\nmodel = 'm'\nsample_rate_hz = 10.0\nrate_range_dps = [-1.0, 1.0]\n"
        "temp_range_c = [0.0, 30.0]\n[plan]\ntemperatures_c = [20.0]\n" + rest
    )


_values = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=5),
    st.lists(st.integers(), max_size=3),
)


@given(
    st.sampled_from(["title", "sensor", "plan", "soak", "settle", "virtual", "limits", "nonsense"]),
    st.one_of(st.text(max_size=8), st.sampled_from(["window_c", "rates_dps", "effects", "seed", "table"])),
    _values,
)
def test_no_value_escapes_as_another_exception(section: str, key: str, value: object) -> None:
    table = tiny()
    if isinstance(table.get(section), dict):
        table[section] = {**table[section], key: value}
    else:
        table[section] = value
    with contextlib.suppress(ProfileError):
        assert profile_from_dict(table, "p.toml").raw == table
