"""When a name is given, and when it is withheld."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.gate import gate
from gyrocal.diagnosis.hypotheses import Hypothesis
from gyrocal.diagnosis.locate import Place
from gyrocal.diagnosis.search import Member, Search

Floats = NDArray[np.float64]


#: Columns of the surface, of a catalogue's law and of a stranger that are orthogonal, or nearly parallel.
APART = np.eye(4)
PARALLEL = np.eye(4)
PARALLEL[2, 3] = PARALLEL[3, 2] = 0.95


def search(columns: Floats = APART, record: tuple[float, ...] = (30.0, 0.0, 20.0, 10.0)) -> Search:
    """A search whose columns have these inner products, and these with the record."""
    gram = np.zeros((5, 5))
    gram[0, 0], gram[0, 1:], gram[1:, 0], gram[1:, 1:] = 2000.0, record, record, columns
    return Search(gram, np.array([0]), [], 100, 0.01, 0)


def member(name: str, coordinate: str, gain: float, column: int = 1) -> Member:
    h = Hypothesis(
        name,
        coordinate,
        "",
        ({},),
        np.full((1, 1), column, dtype=np.int64),
        in_catalogue=not name.startswith("("),
    )
    return Member(h, 0, gain, 1e-9, gain / 2, np.empty((4, 0)))


def place(coordinate: str, excess: float) -> Place:
    return Place(coordinate, -30.0, excess, np.zeros(1, dtype=np.int64), "bias")


def test_an_effect_that_leaves_nothing_is_named() -> None:
    decided = gate([member("shupe", "temperature_rate", 100.0)], [], search())
    assert [m.hypothesis.id for m in decided.named] == ["shupe"]
    assert decided.withheld == ()


@pytest.mark.parametrize(("left", "named"), [(4.0, 1), (40.0, 0)])
def test_structure_left_on_its_own_coordinate_costs_the_name(left: float, named: int) -> None:
    decided = gate([member("warm_up", "time_since_power_on", 100.0)], [place("time", left)], search())
    assert len(decided.named) == named
    assert len(decided.reasons) == 1 - named


def test_structure_elsewhere_does_not_cost_the_name() -> None:
    decided = gate([member("warm_up", "time_since_power_on", 100.0)], [place("table_angle", 80.0)], search())
    assert len(decided.named) == 1


def test_a_stranger_is_located_and_takes_weaker_names_of_its_kind_with_it() -> None:
    members = [
        member("(periodic in time)", "time", 200.0),
        member("shupe", "temperature_rate", 50.0),
        member("table_eccentricity", "table_angle", 50.0),
    ]
    decided = gate(members, [], search())
    assert [m.hypothesis.id for m in decided.named] == ["table_eccentricity"]
    assert any("not in the catalogue lives in time: periodic" in r for r in decided.reasons)


def test_a_patchwork_of_laws_for_one_coordinate_is_no_physics() -> None:
    members = [member(e, "time", 50.0) for e in ("bias_step", "bias_drift", "scale_step")]
    decided = gate(members, [], search())
    assert decided.named == ()
    assert "takes 3 laws" in decided.reasons[0]


@pytest.mark.parametrize(("columns", "named"), [(APART, ["bias_drift"]), (PARALLEL, [])])
def test_a_name_whose_size_hangs_on_a_stranger_is_withheld(columns: Floats, named: list[str]) -> None:
    members = [
        member("bias_drift", "time", 200.0, column=2),
        member("(periodic in time)", "time", 100.0, column=3),
    ]
    # Alone the drift is 20; beside a pattern almost parallel to it, of which there is less, it is three times that.
    decided = gate(members, [], search(columns, (0.0, 0.0, 20.0, 14.0)))
    assert [m.hypothesis.id for m in decided.named] == named
    assert any("its size hangs on a pattern" in reason for reason in decided.reasons) == (not named)
