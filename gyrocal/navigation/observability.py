"""Which of the five constants S_R, S_L, dD, dB_s, dB_rb a log can tell apart, from what the filter has learned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

#: Places of the constants among `gyrocal.fusion.STATES`, and their plain names.
CONSTANTS = (3, 4, 5, 7, 8)
NAMES = ("right wheel scale", "left wheel scale", "wheel separation", "gyro scale", "gyro bias")
#: A deviation below this share of its prior is learned from the log; above the other it has stayed at its prior.
LEARNED, STAYED = 0.5, 0.9
#: Two constants that are correlated beyond this are known together, not apart.
TOGETHER = 0.9
#: A direction names the constants that make up at least this much of it.
_PART = 0.3
#: A log that turned less than this to one side has not turned that way.
_TURNED_DEG = 90.0


@dataclass(frozen=True)
class Direction:
    """A combination of constants, in units of their priors, and its deviation as a share of its prior."""

    weights: Mapping[str, float]
    ratio: float

    def text(self) -> str:
        """The combination in words."""
        parts = [(w, name) for name, w in self.weights.items() if abs(w) >= _PART]
        sign = np.sign(parts[0][0])
        return " ".join(
            f"{'' if k == 0 else '+ ' if w * sign > 0 else '- '}{name}" for k, (w, name) in enumerate(parts)
        )


@dataclass(frozen=True)
class Observability:
    """What a log says of the constants.

    Attributes
    ----------
    prior_std, std : mapping
        Deviations before and after the log, in the units of `STATES`; constants that the filter does not estimate
        are left out.
    directions : tuple of Direction
        Independent combinations, the best known first; a ratio near 1 is a direction the log does not see.
    confused : tuple of pairs
        Constants that are known together only.
    """

    prior_std: Mapping[str, float]
    std: Mapping[str, float]
    directions: tuple[Direction, ...]
    confused: tuple[tuple[str, str], ...]
    turned_left_deg: float
    turned_right_deg: float

    @property
    def ratio(self) -> dict[str, float]:
        """Deviation after the log as a share of the prior."""
        return {name: self.std[name] / self.prior_std[name] for name in self.std}

    @property
    def seen(self) -> int:
        """Number of directions that the log has learned."""
        return sum(d.ratio < LEARNED for d in self.directions)

    def sentences(self) -> tuple[str, ...]:
        """The report in words."""
        ratio = self.ratio
        learned = [name for name, r in ratio.items() if r < LEARNED]
        stayed = [name for name, r in ratio.items() if r > STAYED]
        said = [f"The log sees {self.seen} of {len(self.directions)} directions of the constants."]
        if learned:
            said.append(f"Learned: {', '.join(learned)}.")
        if stayed:
            said.append(f"At their prior: {', '.join(stayed)}.")
        said += [f"Not told apart: {a} and {b}." for a, b in self.confused]
        # A constant by itself that is not seen is at its prior, and that is said.
        unseen = [t for d in self.directions if d.ratio > STAYED and (t := d.text()) not in stayed]
        if unseen:
            said.append(f"Not seen: {'; '.join(unseen)}.")
        sides = {"left": self.turned_left_deg, "right": self.turned_right_deg}
        lacking = [side for side, turned in sides.items() if turned < _TURNED_DEG]
        if lacking:
            said.append(
                f"The robot hardly turned to the {' or the '.join(lacking)}: straights and turns both ways are needed."
            )
        return tuple(said)

    def to_json(self) -> dict[str, Any]:
        """For a report file."""
        return {
            "prior_std": dict(self.prior_std),
            "std": dict(self.std),
            "ratio": self.ratio,
            "directions": [{"weights": dict(d.weights), "ratio": d.ratio} for d in self.directions],
            "seen": self.seen,
            "confused": [list(pair) for pair in self.confused],
            "turned_deg": {"left": self.turned_left_deg, "right": self.turned_right_deg},
            "sentences": list(self.sentences()),
        }


def observability(before: ArrayLike, covariance: ArrayLike, heading_deg: ArrayLike) -> Observability:
    """Compare what the filter knows of the constants after a log with what it knew before.

    Parameters
    ----------
    before, covariance : array_like, shape (9, 9)
        `Navigator.covariance` at the start and after the log. A constant of no variance at the start is not estimated.
    heading_deg : array_like, shape (n,)
        Heading along the log, not wrapped.

    Notes
    -----
    The eigenvalues of the posterior covariance in units of the prior are the directions: 1 where the log adds
    nothing. Heading differences alone see three of the five: a track width and a gyro scale are never told apart.
    """
    prior = np.sqrt(np.diag(np.asarray(before, dtype=np.float64)))
    kept = [(place, name) for place, name in zip(CONSTANTS, NAMES, strict=True) if prior[place] > 0.0]
    places, names = [place for place, _ in kept], [name for _, name in kept]
    p = np.asarray(covariance, dtype=np.float64)[np.ix_(places, places)]
    scaled = p / np.outer(prior[places], prior[places])
    shares, vectors = np.linalg.eigh(scaled)
    directions = tuple(
        Direction(dict(zip(names, vectors[:, k].tolist(), strict=True)), float(np.sqrt(max(shares[k], 0.0))))
        for k in range(len(places))
    )
    std = np.sqrt(np.diag(p))
    correlation = p / np.outer(std, std)
    confused = tuple(
        (names[i], names[j])
        for i in range(len(names))
        for j in range(i + 1, len(names))
        if abs(correlation[i, j]) > TOGETHER
    )
    turns = np.diff(np.asarray(heading_deg, dtype=np.float64))
    return Observability(
        dict(zip(names, prior[places].tolist(), strict=True)),
        dict(zip(names, std.tolist(), strict=True)),
        directions,
        confused,
        float(turns[turns > 0.0].sum()),
        float(np.abs(turns[turns < 0.0]).sum()),
    )
