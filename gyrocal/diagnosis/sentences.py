"""The answer in plain sentences."""

from __future__ import annotations

from gyrocal.diagnosis.result import Alternative, Diagnosis, Estimate, Improvement, NamedEffect


def sentences(d: Diagnosis) -> tuple[str, ...]:
    """Does the recording agree with the simulation; where not; which physics; how sure; what is gained."""
    said = [_VERDICTS[d.verdict]]
    for place in d.located[:4]:
        what = "Scatter" if place.statistic == "variance" else "The mean"
        said.append(
            f"{what} departs in {place.coordinate.replace('_', ' ')}: {place.region} (p = {_p(place.p_value)})."
        )
    for effect in d.effects:
        said += _effect(effect)
    said += list(d.notes)
    if d.improvement is not None and len(d.effects) != 1:
        said.append("All together: " + _gain(d.improvement))
    reasons: dict[str, list[str]] = {}
    for what, reason in d.not_testable.items():
        reasons.setdefault(reason, []).append(what.replace("_", " ") if what in _COORDINATES else what)
    said += [f"Not testable with this record: {', '.join(w)}, because {r}." for r, w in reasons.items()]
    return tuple(said)


_COORDINATES = ("table_angle", "time_since_power_on", "time_since_step", "temperature_rate")


_VERDICTS = {
    "consistent": "The recording agrees with the simulated sequence: nothing beyond noise.",
    "explained": "The recording departs from the simulated sequence, and the physics named below explains it.",
    "partly_explained": "The recording departs from the simulated sequence; the physics named below explains a part of it.",
    "unexplained": "The recording departs from the simulated sequence, and no physics of the catalogue explains it.",
}


def _effect(effect: NamedEffect) -> list[str]:
    values = ", ".join(f"{name} {_value(e)}" for name, e in effect.parameters.items() if e.std > 0)
    said = [f"{effect.effect}: {effect.statement} {values} (p = {_p(effect.p_value)})."]
    if effect.alternatives:
        said.append("The same data could be " + "; ".join(_other(a) for a in effect.alternatives) + ".")
    if effect.improvement is not None:
        said.append(f"{effect.effect}: " + _gain(effect.improvement))
    return said


def _value(e: Estimate) -> str:
    low, high = e.interval_95
    unit = "" if e.unit == "1" else f" {e.unit}"
    return f"{e.value:.4g}{unit} (95 %: {low:.4g} to {high:.4g})"


def _other(a: Alternative) -> str:
    odds = "equally well" if a.evidence_ratio < 1.05 else f"{a.evidence_ratio:.2g} to 1 against it"
    return f"{a.effect} ({odds})"


def _gain(i: Improvement) -> str:
    low, high = i.interval_95
    text = (
        f"on data left out the error falls from {1e3 * i.heldout_rms_before_dps:.3g} to "
        f"{1e3 * i.heldout_rms_after_dps:.3g} mdeg/s rms (drop {1e3 * low:.2g} to {1e3 * high:.2g}), "
        f"noise floor {1e3 * i.noise_floor_dps:.3g}; log-loss from {i.logloss_before:.4g} to {i.logloss_after:.4g} nats a data set."
    )
    return text[0].upper() + text[1:]


def _p(p: float) -> str:
    return "below 1e-12" if p < 1e-12 else f"{p:.2g}"
