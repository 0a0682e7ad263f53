"""The coefficient file: what is loaded, what is refused, and that every refusal is one sentence."""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrocal.errors import CoefficientError
from gyrocal.fusion.coefficients import Coefficients, Valid, load_coefficients, parse_coefficients
from gyrocal.physics.surface import SHAPE, Surface

Body = dict[str, Any]


def sample() -> Body:
    """A sound file, decoded."""
    values = np.random.default_rng(1).normal(size=SHAPE)
    surface = Surface(values, 0.5, 100.0, 20.0, 30.0)
    covariance = np.diag(np.arange(1.0, 13.0)) * 1e-9
    made = Coefficients(
        {"model": "m", "serial": "1"}, surface, covariance, Valid((-100.0, 100.0), (0.0, 40.0))
    )
    body: Body = json.loads(made.to_text())
    return body


def seal(body: Body) -> str:
    """The file's text with its sha256, computed here as formats.md says it."""
    rest = {key: value for key, value in body.items() if key != "sha256"}
    canonical = json.dumps(rest, sort_keys=True, separators=(",", ":"))
    return json.dumps(rest | {"sha256": hashlib.sha256(canonical.encode()).hexdigest()})


def test_the_digest_is_that_of_the_canonical_form() -> None:
    body = sample()
    assert json.loads(seal(body))["sha256"] == body["sha256"]


def test_the_covariance_is_row_major_over_i_j() -> None:
    body = sample()
    assert np.shape(body["surface"]["covariance_dps2"]) == (12, 12)
    loaded = parse_coefficients(seal(body), "f")
    # The variance at the center of the scaled variables is that of c[0][0], the first of the twelve.
    assert loaded.sigma_dps(0.5, 20.0) == pytest.approx(np.sqrt(1e-9))


@pytest.mark.parametrize("version", [0, 1])
def test_this_and_older_schemas_load(version: int) -> None:
    body = sample() | {"schema": f"gyrocal-coefficients/{version}"}
    assert parse_coefficients(seal(body), "f").correct(10.0, 20.0) == pytest.approx(
        parse_coefficients(seal(sample()), "f").correct(10.0, 20.0)
    )


def test_a_byte_order_mark_does_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    path.write_text(seal(sample()), encoding="utf-8-sig")
    assert load_coefficients(path).sensor["model"] == "m"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "truncated or damaged"),
        ("[" * 100_000, "is not a coefficient file"),
        (seal(sample())[:500], "truncated or damaged"),
        ("[1, 2]", "is not a coefficient file"),
        (seal(sample() | {"schema": "gyrocal-coefficients/3"}), "newer than this program"),
        (seal(sample() | {"schema": "gyrocal-coefficients/²"}), "is not a coefficient file"),
        (seal(sample() | {"schema": "gyrocal-coefficients/" + "9" * 5000}), "is not a coefficient file"),
        (seal(sample()).replace('"model": "m"', '"model": "n"'), "was edited"),
        (json.dumps({k: v for k, v in sample().items() if k != "sha256"}), "sha256 is missing"),
    ],
)
def test_what_is_no_sound_file_is_refused(text: str, words: str) -> None:
    with pytest.raises(CoefficientError, match=words) as refused:
        parse_coefficients(text, "c.json")
    assert str(refused.value).startswith("c.json")


def _set(*path: str, to: Any) -> Callable[[Body], None]:
    def change(body: Body) -> None:
        for key in path[:-1]:
            body = body[key]
        body[path[-1]] = to

    return change


@pytest.mark.parametrize(
    "change",
    [
        _set("sensor", to="KVH"),
        _set("sensor", to=[1]),
        _set("noise", to=[1]),
        _set("figures", to=[1]),
        _set("provenance", to="x"),
        _set("terms", to=[{"effect": "shupe", "parameters": [1], "runtime": True}]),
        _set("surface", "rate", "scale_dps", to=10**400),
        _set("surface", "covariance_dps2", to=[[1.0]]),
        _set("surface", "coefficients_dps", to=[[1.0] * 4] * 3),
        _set("valid", to=None),
    ],
)
def test_a_sealed_file_of_the_wrong_shape_is_refused(change: Callable[[Body], None]) -> None:
    body = copy.deepcopy(sample())
    change(body)
    with pytest.raises(CoefficientError, match=r"^f: is malformed .* Fit again\.$"):
        parse_coefficients(seal(body), "f")
