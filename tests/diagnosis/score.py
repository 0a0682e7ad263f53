"""The finder against concealed recordings: the table "To reach" of the diagnose issue, with 95 % Wilson intervals.

A command line; results go to JSON lines as they come, and a repeated call goes on where the last one stopped::

    nice -n 10 python -m tests.diagnosis.score --trials 200 --seed 1 --out results.jsonl
    python -m tests.diagnosis.score --practice
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal.diagnosis.engine import diagnose
from gyrocal.diagnosis.result import Diagnosis
from gyrocal.physics.catalogue import CATALOGUE
from tests.diagnosis.concealed_bench import Recording, make_recording, write_run
from tests.diagnosis.concealed_effects import CATALOGUE as CONCEALED
from tests.diagnosis.concealed_outside import OUTSIDE, SEEN, UNSEEN
from tests.diagnosis.concealed_world import PLANS, Floats
from tests.diagnosis.score_table import Outcome, format_table

SHARED = Path(__file__).parents[2].parent / "shared" / "concealed"

#: One id of each law: earth rate, field and gravity turn alike on a table.
SINGLES = (*(e for e in CONCEALED if e not in ("magnetic", "g_sensitivity")), "thermal_lag", "truncation")
#: Acts with a size of its own: level in the unit of `concealed_bench`.
LEVELS = {"fit_direction": 0.0, "quantisation": 12.0, "time_base": 2000.0, "bursts": 0.3}
#: Parameters that mean the same here and in the catalogue, and the unit of the amplitude there in the unit here.
COMPARABLE: dict[str, tuple[float, tuple[str, ...]]] = {
    "shupe": (1.0, ()),
    "shupe_gradient": (1.0, ("tau_s",)),
    "thermal_lag": (1.0, ("tau_s",)),
    "warm_up": (1.0, ("tau_s",)),
    "bias_step": (1.0, ("at_s",)),
    "scale_step": (1.0, ("at_s",)),
    "scale_asymmetry": (1.0, ()),
    "dead_zone": (1.0, ()),
    "truncation": (0.5, ()),
    "sagnac_sine": (1.0, ("phase_rad_per_dps",)),
    "mechanical_resonance": (1.0, ("center_dps",)),
    "supply_voltage": (1.0, ()),
    "table_eccentricity": (1.0, ()),
    "earth_rate_tilt": (1.0, ()),
}
#: Times a slope of the surface of 0.01 this is 0.5 mdeg/s, the floor of the noise.
_LARGE_DPS = 0.05
_UNSIGNED = ("table_eccentricity", "earth_rate_tilt")


@dataclass(frozen=True)
class Case:
    """A recording to make: what kind of trial, which effects at which d', which seed."""

    kind: str
    effects: tuple[tuple[str, float], ...]
    seed: int
    plan: str | None = None

    @property
    def key(self) -> str:
        """Name of the case in the results."""
        return f"{self.kind}:{'+'.join(f'{e}@{s:g}' for e, s in self.effects)}:{self.seed}"


def cases(trials: int, seed: int, plan: str | None = None) -> Iterator[Case]:
    """`trials` cases, kinds and effects interleaved so that any beginning of the list is a fair sample."""
    rng = np.random.default_rng([77, seed])
    # Of twenty trials.
    wheel = ["null", "8", "12", "20", "pair", "outside", "strong", "12", "null", "8"]
    wheel += ["20", "pair", "outside", "12", "8", "null", "strong", "outside", "20", "level"]
    order = {kind: rng.permutation(len(SINGLES)) for kind in ("8", "12", "20", "strong")}
    outside = rng.permutation(list(SEEN))
    count = dict.fromkeys([*wheel], 0)
    for n in range(trials):
        kind = wheel[n % len(wheel)]
        k = count[kind]
        count[kind] += 1
        effects: tuple[tuple[str, float], ...] = ()
        if kind in order:
            strength = float((100, 300)[k % 2]) if kind == "strong" else float(kind)
            effects = ((SINGLES[int(order[kind][k % len(SINGLES)])], strength),)
        elif kind == "pair":
            first, second = rng.choice(SINGLES, 2, replace=False)
            strength = float((12, 20)[k % 2])
            effects = ((str(first), strength), (str(second), strength))
        elif kind == "outside":
            effects = ((str(outside[k % len(outside)]), float((12, 20)[(k // len(outside) + k) % 2])),)
        elif kind == "level":
            effects = (list(LEVELS.items())[k % len(LEVELS)],)
        yield Case("single" if kind in order else kind, effects, 100_000 * seed + n, plan)


def unseen(seed: int, plan: str | None = None) -> Iterator[Case]:
    """Every effect outside the catalogue that was written after the finder, at d' 20 and 12."""
    for k, strength in enumerate((20.0, 12.0)):
        for n, effect in enumerate(UNSEEN):
            yield Case("outside", ((effect, strength),), 100_000 * seed + 100 * k + n, plan)


def run_case(case: Case) -> Outcome:
    """Make the recording, diagnose it, and compare the answer with the truth."""
    recording = make_recording(list(case.effects), case.seed, case.plan)
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "run"
        write_run(recording, path)
        started = time.perf_counter()
        found = diagnose(path)
        elapsed = time.perf_counter() - started
    return judge(case, recording, found, elapsed)


def judge(case: Case, recording: Recording, found: Diagnosis, elapsed_s: float) -> Outcome:
    """Compare an answer with what was hidden."""
    truth = [h.effect for h in recording.hidden]
    named = [e.effect for e in found.effects]
    classes = [[e.effect, *(a.effect for a in e.alternatives)] for e in found.effects]
    family = CATALOGUE[truth[0]].family if truth and truth[0] in CATALOGUE else ""
    places = [p.coordinate for p in found.located]
    accepted = OUTSIDE[truth[0]][1] if truth and truth[0] in OUTSIDE else ()
    return Outcome(
        key=case.key,
        kind=case.kind,
        truth=truth,
        d_prime=float(recording.hidden[0].d_prime) if recording.hidden else 0.0,
        verdict=found.verdict,
        named=named,
        first_class=classes[0] if classes else [],
        family_right=bool(found.effects) and found.effects[0].family == family,
        located=places,
        place_right=any(p in accepted for p in places),
        covered=_coverage(recording, found),
        gain_share=_gain_share(recording, found),
        heldout_rms_dps=None
        if found.improvement is None
        else [found.improvement.heldout_rms_before_dps, found.improvement.heldout_rms_after_dps],
        elapsed_s=elapsed_s,
    )


def _coverage(recording: Recording, found: Diagnosis) -> dict[str, bool]:
    """Whether each comparable parameter of each effect that was rightly named lies in its 95 % interval."""
    covered = {}
    for hidden in recording.hidden:
        match = [e for e in found.effects if e.effect == hidden.effect]
        if not match or hidden.effect not in COMPARABLE:
            continue
        scale, names = COMPARABLE[hidden.effect]
        true = {"amplitude": hidden.amplitude * scale} | {n: hidden.parameters[n] for n in names}
        for name, value in true.items():
            if name not in match[0].parameters:
                continue
            low, high = match[0].parameters[name].interval_95
            inside = low <= value <= high
            if hidden.effect in _UNSIGNED:
                inside = inside or low <= -value <= high
            covered[f"{hidden.effect}.{name}"] = bool(inside)
    return covered


def _gain_share(recording: Recording, found: Diagnosis) -> float | None:
    """Expected gain in log-loss on a fresh run of the same plan, as a share of what an oracle gains.

    The oracle knows the shape of the effect and estimates its size: it removes all of the effect's d'^2 but one.
    None where the effect is so large that it moves the argument of the surface itself: then no sum of the two holds.
    """
    if any(h.rms_dps > _LARGE_DPS for h in recording.hidden):
        return None
    if recording.yardstick is None or not recording.effect_dps.size or found.rows is None:
        return None
    truth = recording.effect_dps.sum(axis=0)
    d_prime = recording.yardstick.d_prime(truth)
    modelled = np.zeros(truth.size)
    for effect in found.rows.effect_dps.values():
        modelled += _on_rows(recording, found, effect)
    left = recording.yardstick.d_prime(modelled - truth) if np.any(modelled) else d_prime
    return float((1.0 - (left / d_prime) ** 2) / (1.0 - len(recording.hidden) / d_prime**2))


def _on_rows(recording: Recording, found: Diagnosis, effect_dps: Floats) -> Floats:
    """An effect on the finder's bins, interpolated to the rows of the recording, segment by segment."""
    if found.rows is None:
        return np.zeros(recording.gyro_t_s.size)
    out = np.zeros(recording.gyro_t_s.size)
    sets = recording.world.row_set()
    for k in np.unique(found.rows.set_index):
        mine, theirs = sets == k, found.rows.set_index == k
        out[mine] = np.interp(recording.gyro_t_s[mine], found.rows.t_s[theirs], effect_dps[theirs])
    return out


def run_all(todo: Iterable[Case], out: Path, say: bool = True) -> list[Outcome]:
    """Run the cases that `out` does not hold yet; every result is written at once."""
    known = {}
    if out.exists():
        known = {o["key"]: Outcome(**o) for o in map(json.loads, out.read_text().splitlines())}
    results = []
    with out.open("a") as stream:
        for case in todo:
            outcome = known.get(case.key)
            if outcome is None:
                outcome = run_case(case)
                stream.write(json.dumps(asdict(outcome)) + "\n")
                stream.flush()
                if say:
                    sys.stdout.write(f"{outcome.line()}\n")
                    sys.stdout.flush()
            results.append(outcome)
    return results


def practice() -> list[str]:
    """The practice recordings, one line each: what is hidden and what is found."""
    answers: dict[str, Any] = json.loads((SHARED / "answers.json").read_text())
    lines = []
    for name, answer in answers.items():
        started = time.perf_counter()
        found = diagnose(SHARED / name)
        hidden = ", ".join(f"{e['effect']} (d' {e['d_prime']:g})" for e in answer["effects"]) or "nothing"
        named = ", ".join(
            e.effect + (f" [or {', '.join(a.effect for a in e.alternatives)}]" if e.alternatives else "")
            for e in found.effects
        )
        places = ", ".join(f"{p.coordinate} ({p.p_value:.1e})" for p in found.located[:3])
        lines.append(
            f"{name}: hidden {hidden}; {found.verdict}: {named or 'nothing named'}; located {places or 'nowhere'}; {time.perf_counter() - started:.1f} s"
        )
    return lines


def main() -> None:
    """Score the finder."""
    parser = argparse.ArgumentParser(description="Score the finder on concealed recordings.")
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("score.jsonl"))
    parser.add_argument("--plan", choices=list(PLANS), help="One plan for all; drawn unless given.")
    parser.add_argument(
        "--unseen", action="store_true", help="Each effect that the finder was not made with."
    )
    parser.add_argument("--practice", action="store_true")
    args = parser.parse_args()
    if args.practice:
        sys.stdout.write("\n".join(practice()) + "\n")
        return
    todo = cases(args.trials, args.seed, args.plan)
    if args.unseen:
        todo = unseen(args.seed, args.plan)
    sys.stdout.write(f"plans {', '.join(PLANS)}; seed {args.seed}\n")
    sys.stdout.write(format_table(run_all(todo, args.out)))


if __name__ == "__main__":
    main()
