"""When a name is given, and when it is withheld."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal.diagnosis.gate import gate
from gyrocal.diagnosis.hypotheses import Hypothesis
from gyrocal.diagnosis.locate import Place
from gyrocal.diagnosis.search import Member


def member(name: str, coordinate: str, gain: float) -> Member:
    h = Hypothesis(
        name, coordinate, "", ({},), np.zeros((1, 1), dtype=np.int64), in_catalogue=not name.startswith("(")
    )
    return Member(h, 0, gain, 1e-9, gain / 2, np.empty((1, 0)))


def place(coordinate: str, excess: float) -> Place:
    return Place(coordinate, -30.0, excess, np.zeros(1, dtype=np.int64), "bias")


def test_an_effect_that_leaves_nothing_is_named() -> None:
    decided = gate([member("shupe", "temperature_rate", 100.0)], [])
    assert [m.hypothesis.id for m in decided.named] == ["shupe"]
    assert decided.withheld == ()


@pytest.mark.parametrize(("left", "named"), [(4.0, 1), (40.0, 0)])
def test_structure_left_on_its_own_coordinate_costs_the_name(left: float, named: int) -> None:
    decided = gate([member("warm_up", "time_since_power_on", 100.0)], [place("time", left)])
    assert len(decided.named) == named
    assert len(decided.reasons) == 1 - named


def test_structure_elsewhere_does_not_cost_the_name() -> None:
    decided = gate([member("warm_up", "time_since_power_on", 100.0)], [place("table_angle", 80.0)])
    assert len(decided.named) == 1


def test_a_stranger_is_located_and_takes_weaker_names_of_its_kind_with_it() -> None:
    members = [
        member("(periodic in time)", "time", 200.0),
        member("shupe", "temperature_rate", 50.0),
        member("table_eccentricity", "table_angle", 50.0),
    ]
    decided = gate(members, [])
    assert [m.hypothesis.id for m in decided.named] == ["table_eccentricity"]
    assert any("not in the catalogue lives in time: periodic" in r for r in decided.reasons)


def test_a_patchwork_of_laws_for_one_coordinate_is_no_physics() -> None:
    members = [member(e, "time", 50.0) for e in ("bias_step", "bias_drift", "scale_step")]
    decided = gate(members, [])
    assert decided.named == ()
    assert "takes 3 laws" in decided.reasons[0]
