"""The error on data left out, layer by layer, and what has no name: in words, as tables and as a picture."""

from __future__ import annotations

from matplotlib.figure import Figure

from gyrocal.diagnosis.result import Diagnosis, Layer, Located, NamedEffect, UnnamedPart
from gyrocal.report import style
from gyrocal.report.words import coordinate_words, fixed, listed, place_words, times_text
from gyrocal.units import MDPS, decimals

_LARGE_DPS = 0.3
#: Above the highest step there is room for its number.
_HEADROOM = 1.15
#: A bar that is higher than this share of the axis has room for its number within.
_ROOM = 0.12
_MOST_LAWS = 3
#: A share so near to nothing or to all is told as that.
_NEARLY = 0.01

#: Families whose gain lives in ramps, within a turn or after a step, and hardly in the means of data sets.
NOT_IN_MEANS = ("thermal transient", "angle, constant", "angle, with rate", "step")

STAIRCASE_CAPTION = (
    "The rms of means of data sets that were left out, with the surface alone and with one layer more at each step, the strongest "
    "first. Lines: what noise alone would leave."
)


def layer_rows(d: Diagnosis) -> list[tuple[str, str, str]]:
    """Layer, error left out and noise floor: cells of a table."""
    if not d.layers:
        return []
    scale, unit = _scale(d)
    places = decimals(scale * min(layer.noise_floor_dps for layer in d.layers))
    return [
        (
            layer_words(d, layer),
            f"{fixed(scale * layer.heldout_rms_dps, places)} {unit}",
            f"{fixed(scale * layer.noise_floor_dps, places)} {unit}",
        )
        for layer in d.layers
    ]


def not_a_step(d: Diagnosis) -> str:
    """Which named effects are no step of the staircase, and why; empty where all are, or there is none."""
    steps = {layer.name for layer in d.layers}
    by_reason: dict[str, list[str]] = {}
    for effect in d.effects if d.layers else ():
        if effect.effect not in steps:
            by_reason.setdefault(_why_no_step(effect), []).append(effect.effect)
    lacking = "; ".join(f"{listed(names)}, {why}" for why, names in by_reason.items())
    return f"No steps of their own have {lacking}." if lacking else ""


def _why_no_step(effect: NamedEffect) -> str:
    if effect.seen is not None:
        return "found in single samples or data sets"
    if effect.family in NOT_IN_MEANS:
        return "found within data sets, whose means hardly show it"
    return "which parts without a name stand for in the model that the steps are of"


def layer_words(d: Diagnosis, layer: Layer) -> str:
    """What a step of the staircase adds."""
    if not layer.name:
        return "surface alone"
    if layer.name in {e.effect for e in d.effects}:
        return layer.name
    return f"{layer.name.replace('_', ' ')}, no name"


def staircase_sentence(d: Diagnosis) -> str:
    """All steps in one sentence; empty where there are fewer than two."""
    if len(d.layers) < 3:
        return ""
    scale, unit = _scale(d)
    places = decimals(scale * min(layer.noise_floor_dps for layer in d.layers))
    steps = [f"{layer_words(d, layer)} {fixed(scale * layer.heldout_rms_dps, places)}" for layer in d.layers]
    floor = fixed(scale * d.layers[-1].noise_floor_dps, places)
    return (
        f"Layer by layer on data left out, {unit} rms: {', '.join(steps)}; noise alone would leave {floor}. "
        + not_a_step(d)
    ).rstrip()


def unnamed_sentences(d: Diagnosis) -> list[str]:
    """What has no name: where, how large, which laws came nearest, and whether the improved file has it."""
    return [_unnamed(part) for part in d.unnamed]


def _unnamed(part: UnnamedPart) -> str:
    place = Located(
        part.coordinate, "mean", 0.0, 1.0, low=part.low, high=part.high, unit=part.unit, rms_dps=part.rms_dps
    )
    where = place_words(place, coordinate_words(part.coordinate))
    said = f"Without a name: {where}, {times_text(part.evidence_nats)} to 1 for it"
    tried = sorted(part.nearest.items(), key=lambda item: item[1])[:_MOST_LAWS]
    shares = {effect: 1.0 - nats / part.evidence_nats for effect, nats in tried}
    near = [f"{effect} (takes {_taken(share)})" for effect, share in shares.items() if share >= _NEARLY]
    if shares and not near:
        said += "; no law that was tried takes any of it"
    if near:
        said += f"; nearest {'is' if len(near) == 1 else 'are'} {listed(near)}"
    return f"{said}. It is {'' if part.corrected else 'not '}corrected."


def _taken(share: float) -> str:
    """How much of the evidence a law takes; beside the rest of a model it can be more than all."""
    return "all of it" if share > 1.0 - _NEARLY else f"{100 * share:.0f} % of it"


def nameless(d: Diagnosis) -> bool:
    """Whether a step of the staircase has no name."""
    return any(layer_words(d, layer) not in ("surface alone", layer.name) for layer in d.layers)


@style.styled
def staircase_figure(d: Diagnosis) -> Figure:
    """Steps down from the surface alone to what is left, over the noise."""
    scale, unit = _scale(d)
    figure = style.new_figure(style.TWO_COLUMNS_IN, 2.4)
    axes = figure.subplots()
    at = range(len(d.layers))
    heights = [scale * layer.heldout_rms_dps for layer in d.layers]
    floors = [scale * layer.noise_floor_dps for layer in d.layers]
    axes.bar(at, heights, width=0.6, color=[style.ORANGE, *[style.BLUE] * (len(heights) - 1)])
    left, right = [x - 0.4 for x in at], [x + 0.4 for x in at]
    axes.hlines(floors, left, right, color=style.INK, linewidth=1.2, label="what noise alone would leave")
    top = _HEADROOM * max(*heights, *floors)
    places = decimals(min(floors))
    for x, height, floor in zip(at, heights, floors, strict=True):
        # Over a line of noise that lies above the bar the number would be read as the noise's.
        within = height < floor and height > _ROOM * top
        axes.annotate(
            fixed(height, places),
            (x, height),
            xytext=(0, -2 if within else 2),
            textcoords="offset points",
            ha="center",
            va="top" if within else "bottom",
            color="white" if within else style.INK,
            fontsize=7,
        )
    axes.set_ylim(0.0, top)
    figure.legend(loc="outside upper right")
    axes.set_xticks(list(at), [_broken(layer_words(d, layer)) for layer in d.layers])
    axes.set_ylabel(f"Left out, {unit} rms")
    axes.grid(visible=False, axis="x")
    return figure


def _broken(words: str) -> str:
    """In lines that stand beside each other under the bars."""
    return words.replace(", ", ",\n").replace("_", "_\n").replace(" ", "\n")


def _scale(d: Diagnosis) -> tuple[float, str]:
    large = max(layer.heldout_rms_dps for layer in d.layers) > _LARGE_DPS
    return (1.0, "deg/s") if large else (1.0 / MDPS, "mdeg/s")
