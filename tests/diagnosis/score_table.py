"""Outcomes of diagnosed concealed recordings, and their table with intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import stats

#: On a table these turn alike; each is right for the others.
SAME_LAW = frozenset(("earth_rate_tilt", "magnetic", "g_sensitivity"))


@dataclass(frozen=True)
class Outcome:
    """One recording: the truth and the answer."""

    key: str
    kind: str
    truth: list[str]
    d_prime: float
    verdict: str
    named: list[str]
    first_class: list[str]
    family_right: bool
    located: list[str]
    place_right: bool
    covered: dict[str, bool] = field(default_factory=dict)
    gain_share: float | None = None
    heldout_rms_dps: list[float] | None = None
    elapsed_s: float = 0.0

    @property
    def first_right(self) -> bool:
        """The effect that was hidden is the first that is named."""
        return bool(self.named) and _same(self.named[0], self.truth[0])

    @property
    def class_right(self) -> bool:
        """The effect that was hidden is the first name or one of its alternatives."""
        return any(_same(e, self.truth[0]) for e in self.first_class)

    @property
    def exact(self) -> bool:
        """Named is what was hidden, no more and no less."""
        return Counter(map(_law, self.named)) == Counter(map(_law, self.truth))

    @property
    def outside_right(self) -> bool:
        """An effect outside the catalogue is not explained away, and its coordinate is located."""
        return self.verdict not in ("explained", "consistent") and self.place_right

    def line(self) -> str:
        """One line for a log."""
        gain = "" if self.gain_share is None else f" gain {self.gain_share:.2f}"
        cls = f" class {','.join(self.first_class)}" if len(self.first_class) > 1 else ""
        return (
            f"{self.key:58s} {self.verdict:16s} named {','.join(self.named) or '-'}{cls}; "
            f"located {','.join(self.located[:4]) or '-'}{gain} {self.elapsed_s:.1f} s"
        )


def _law(effect: str) -> str:
    return "earth_rate_tilt" if effect in SAME_LAW else effect


def _same(a: str, b: str) -> bool:
    return _law(a) == _law(b)


def wilson(hits: int, n: int, level: float = 0.95) -> tuple[float, float]:
    """Wilson score interval of a share."""
    if n == 0:
        return 0.0, 1.0
    z = float(stats.norm.ppf(0.5 + level / 2))
    p, denominator = hits / n, 1 + z**2 / n
    middle = (p + z**2 / (2 * n)) / denominator
    half = z * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2)) / denominator
    return float(middle - half), float(middle + half)


def _row(name: str, hits: Sequence[bool], goal: str) -> str:
    n, k = len(hits), int(sum(hits))
    if not n:
        return f"{name:58s} {'-':>9s} {'':17s} goal {goal}"
    low, high = wilson(k, n)
    return f"{name:58s} {k:4d}/{n:<4d} {k / n:6.1%} [{low:5.1%}, {high:6.1%}] goal {goal}"


def format_table(outcomes: Sequence[Outcome]) -> str:
    """The table "To reach", the confusion matrix, and who is worst."""
    singles = [o for o in outcomes if o.kind == "single"]

    def at(*strengths: float) -> list[Outcome]:
        return [o for o in singles if any(abs(o.d_prime - s) < 0.01 * s for s in strengths)]

    lines = [
        _row(
            "nothing hidden: any effect named",
            [bool(o.named) for o in outcomes if o.kind == "null"],
            "<= 2 %",
        )
    ]
    lines.append(
        _row(
            "nothing hidden: not consistent",
            [o.verdict != "consistent" for o in outcomes if o.kind == "null"],
            "-",
        )
    )
    for name, group, goals in (
        ("one, d' 20", at(20), (">= 97 %", "", "")),
        ("one, d' 12", at(12), (">= 92 %", ">= 98 %", ">= 98 %")),
        ("one, d' 8", at(8), (">= 85 %", ">= 95 %", ">= 98 %")),
    ):
        lines.append(_row(f"{name}: right name first", [o.first_right for o in group], goals[0]))
        lines.append(_row(f"{name}: in the reported class", [o.class_right for o in group], goals[1]))
        lines.append(_row(f"{name}: right family", [o.family_right for o in group], goals[2]))
    lines.append(
        _row("two, d' >= 12 each: exact set", [o.exact for o in outcomes if o.kind == "pair"], ">= 88 %")
    )
    for strength, goal in ((20, ">= 95 %"), (12, ">= 80 %")):
        group = [o for o in outcomes if o.kind == "outside" and abs(o.d_prime - strength) < 1]
        lines.append(
            _row(
                f"outside the catalogue, d' {strength}: not explained, located",
                [o.outside_right for o in group],
                goal,
            )
        )
    strong = at(100, 300)
    lines.append(_row("strong (d' 100, 300): right name first", [o.first_right for o in strong], ""))
    lines.append(
        _row("strong (d' 100, 300): no other name", [len(o.named) <= 1 or o.exact for o in strong], ">= 95 %")
    )
    levels = [o for o in outcomes if o.kind == "level"]
    lines.append(
        _row("of one size (fit direction, sampling): right name first", [o.first_right for o in levels], "")
    )
    lines.append(
        _row(
            "95 % intervals of parameters cover", [c for o in outcomes for c in o.covered.values()], "92-98 %"
        )
    )
    gains = [o.gain_share for o in singles if o.gain_share is not None]
    if gains:
        lines.append(
            f"gain as a share of an oracle's: median {np.median(gains):.3f}, lower decile {np.quantile(gains, 0.1):.3f}, n {len(gains)}; goal >= 0.95"
        )
    seconds = [o.elapsed_s for o in outcomes]
    if seconds:
        lines.append(
            f"seconds a recording: median {np.median(seconds):.1f}, most {np.max(seconds):.1f}; goal <= 20"
        )
    return "\n".join([*lines, "", *_confusion(singles), "", *_coverage_table(outcomes)]) + "\n"


def _confusion(singles: Sequence[Outcome]) -> list[str]:
    """Per hidden effect: how often right, and what it was taken for."""
    lines = [
        "hidden effect: right first / trials; otherwise first name (d'), or verdict when none; extra names"
    ]
    for effect in sorted({o.truth[0] for o in singles}):
        mine = [o for o in singles if o.truth[0] == effect]
        wrong = Counter(f"{(o.named or [o.verdict])[0]} ({o.d_prime:g})" for o in mine if not o.first_right)
        extra = Counter(e for o in mine if o.first_right for e in o.named[1:])
        verdicts = Counter(o.verdict for o in mine if o.first_right and o.verdict != "explained")
        notes = [f"{k} x{n}" for k, n in wrong.most_common()]
        notes += [f"extra {k} x{n}" for k, n in extra.most_common()]
        notes += [f"verdict {k} x{n}" for k, n in verdicts.most_common()]
        lines.append(f"  {effect:22s} {sum(o.first_right for o in mine)}/{len(mine)}  {'; '.join(notes)}")
    return lines


def _coverage_table(outcomes: Sequence[Outcome]) -> list[str]:
    counts: dict[str, list[bool]] = {}
    for o in outcomes:
        for name, inside in o.covered.items():
            counts.setdefault(name, []).append(inside)
    head = "parameter: intervals that cover / trials"
    return [head, *(f"  {k:36s} {sum(v)}/{len(v)}" for k, v in sorted(counts.items()))]
