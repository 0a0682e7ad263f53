"""Laws of a bias that comes with the motion: which of them a log holds, where it tells little of the lag."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from gyrocal.diagnosis.drive.laws import AT_ONCE, SETTLING, is_motion
from gyrocal.diagnosis.drive.levels import GAIN
from gyrocal.diagnosis.drive.weighing import Evidence

Floats = NDArray[np.float64]

#: Gain by which a law is 20 times as likely as another: with less, either may have made the log.
AS_LIKELY = 2.0 * float(np.log(20.0))


def of_motion(laws: Iterable[str]) -> list[str]:
    """Laws of a bias that comes with the motion: they differ by the lag alone."""
    return [n for n in laws if is_motion(n)]


def of_change(laws: Iterable[str]) -> list[str]:
    """Laws of a bias that is another one in motion, or at another temperature."""
    return [n for n in laws if is_motion(n) or n == "slope"]


def likely_motions(told: Evidence, chosen: Sequence[str], motions: Sequence[str]) -> tuple[Floats, Floats]:
    """How likely each law of the motion is in place of that which is chosen, and its coefficient then."""
    beside = [n for n in chosen if n not in motions]
    gains = np.array([told.added(beside, [n]) for n in motions])
    likely = np.exp(0.5 * (gains - gains.max()))
    values = np.array([told.own.solve([*beside, n])[0][-1] for n in motions])
    return likely / likely.sum(), values


def with_central_lag(told: Evidence, chosen: Sequence[str], motions: Sequence[str]) -> list[str]:
    """With that law of the motion, of those that are as likely as not, whose bias is nearest to the mean of all.

    A later rest that is short tells little of the lag, and of the bias only together with that.
    """
    taken = next((n for n in chosen if n in motions), None)
    if taken is None:
        return list(chosen)
    likely, values = likely_motions(told, chosen, motions)
    away = np.where(likely >= 0.5 * likely.max(), np.abs(values - likely @ values), np.inf)
    return [motions[int(np.argmin(away))] if n == taken else n for n in chosen]


def temperature_for_motion(told: Evidence, chosen: Sequence[str], laws: Iterable[str]) -> list[str]:
    """With a bias that goes by the temperature in place of one that came with the motion and did not go with it.

    Later rests at which a bias stays as it is in motion deny that the motion made it; what then changed between the rest at
    the start and the drive is as well, and in gyros more often, the temperature.
    """
    laws = list(laws)
    taken = next((n for n in chosen if is_motion(n)), None)
    if taken is None or "slope" in chosen or not {"slope", AT_ONCE} <= set(laws):
        return list(chosen)
    beside = [n for n in chosen if n != taken]
    gain, warmed, at_once = (told.added(beside, [n]) for n in (taken, "slope", AT_ONCE))
    denied, as_likely = at_once < gain - AS_LIKELY, warmed >= max(GAIN, gain - AS_LIKELY)
    return ["slope" if n == taken else n for n in chosen] if denied and as_likely else list(chosen)


def rather_than_wheels(told: Evidence, chosen: Sequence[str], laws: Iterable[str], least: float) -> list[str]:
    """Laws of a bias that comes with the motion, and of one over the temperature, where one of a kind is there and explains surely more than wheels that differ, each without the other.

    Either makes the two headings part on a straight, and beside wheels that may differ by anything no bias is seen.

    Parameters
    ----------
    least : gain from which on it is there
    """
    if "asymmetry" not in chosen:
        return []
    looked_at = [*laws]
    kinds = [of_motion(looked_at), [n for n in looked_at if n == "slope"]]
    beside = [n for n in chosen if n != "asymmetry"]
    much = max(least, told.added(beside, ["asymmetry"]) + AS_LIKELY)
    return [
        n
        for kind in kinds
        if kind and not any(n in kind for n in chosen)
        if max(told.added(beside, [n]) for n in kind) > much
        for n in kind
    ]


def settling_beats(told: Evidence, beside: Sequence[str], name: str, least: float = 0.0) -> bool:
    """Whether a bias that settles by itself is there, and explains surely more than a law of the motion does in its place.

    Its time constant is anything: the likelihood is a mean over all that are tried.

    Parameters
    ----------
    least : gain from which on it is there
    """
    settling = settling_gain(told, beside)
    return settling > max(least, told.added(beside, [name]) + AS_LIKELY)


def settling_gain(told: Evidence, beside: Sequence[str]) -> float:
    """What a bias that settles by itself gains, of any time constant; minus infinity where none was looked at."""
    return mean_gain(np.array([told.added(beside, [n]) for n in told.own.names if n in SETTLING]))


def mean_gain(gains: Floats) -> float:
    """Gain of a law of any of several shapes, each as likely beforehand; minus infinity where there are none."""
    return 2.0 * float(logsumexp(0.5 * gains, b=1.0 / gains.size)) if gains.size else -np.inf


def with_settling(told: Evidence, chosen: Sequence[str]) -> list[str]:
    """Laws with one of a bias that settles by itself in place of what it denies, or beside what came with the motion.

    It denies what it explains surely more than, unless that is there beside it, too: gyros warm up by themselves, on drives
    that go with no temperature and begin with no motion.
    """
    if "jump" in chosen:
        # A jump beside a slope over temperature may be what the slope lacks of it.
        settled = with_settling(told, [n for n in chosen if n != "jump"])
        if any(n in SETTLING for n in settled) and told.added(settled, ["jump"]) < GAIN:
            return settled
    found = list(chosen)
    for name in of_change(chosen):
        beside = [n for n in found if n != name]
        settling = likeliest_settling(told, found, GAIN)
        stays = bool(settling) and told.added([*beside, *settling], [name]) >= GAIN
        if settling_beats(told, beside, name) and not stays:
            found = beside
    if len(found) < len(chosen) or of_motion(found):
        found += likeliest_settling(told, found, GAIN)
    return found


def likeliest_settling(told: Evidence, beside: Sequence[str], least: float) -> list[str]:
    """The likeliest law of a bias that settles by itself beside others; none where it gains less than `least`."""
    gains = {n: told.added(beside, [n]) for n in told.own.names if n in SETTLING}
    return [n for n in sorted(gains, key=lambda n: -gains[n])[:1] if gains[n] >= least]


def may_be_another(told: Evidence, beside: Sequence[str], name: str, instead: Sequence[str]) -> bool:
    """Whether one of other laws in the place of one is as likely as it is."""
    gain = told.added(beside, [name])
    return any(told.added(beside, [n]) > gain - AS_LIKELY for n in instead)


def or_nothing(value: float, std: float, likely: float) -> tuple[float, float]:
    """Mean and standard deviation of a figure that is as likely there, and else zero."""
    return likely * value, float(np.sqrt(likely * (std**2 + (1.0 - likely) * value**2)))
