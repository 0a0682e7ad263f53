"""Words of the remarks of a diagnosis, and of what was named."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from gyrocal.calibration.checks import no_rate_text
from gyrocal.diagnosis.remarks import Note, Remark, Said
from gyrocal.diagnosis.result import NamedEffect
from gyrocal.physics.catalogue import described
from gyrocal.report.words import listed
from gyrocal.units import NORMAL_95, dph, plural


def _stray_sets(sets: Sequence[int]) -> str:
    return plural(
        len(sets),
        f"data [set|sets] {', '.join(map(str, sets))} [is|are] far off the line of the others, which hides what is small: "
        "[was its rate|were their rates] mixed up? Repair or remove [it|them]",
    )


def _few_temperatures(*, count: int, branches: bool) -> str:
    nor = "" if branches else ", nor has a hysteresis of the bias"
    return (
        f"it turned in {count} visits to a temperature, one after the other: what changes the scale factor over temperature or time "
        f"beyond the surface has no name here{nor}; turn at five or more, up and down"
    )


def _edge(*, of_scale: bool, **facts: float) -> str:
    """Size in ppm or mdeg/s, center and width in degC, each with its interval."""
    what, unit, digits = ("scale factor", "ppm", 0) if of_scale else ("bias", "mdeg/s", 2)
    size, low, high = (f"{facts[key]:.{digits}f}" for key in ("size", "size_low", "size_high"))
    return (
        f"The {what} changes by {size} {unit} (95 %: {low} to {high})"
        " about {center_c:.4g} degC ({center_low:.4g} to {center_high:.4g}), three quarters of it within {width_c:.2g} degC "
        "({width_low:.2g} to {width_high:.2g}) of there: it goes with the temperature, which came by more than once, and not with "
        "time. It is a curve without a name.".format(**facts)
    )


def _give_times(leaps: int, sets: float, effects: list[str], left_out: list[str]) -> str:
    """What of a table without times depends on how long its leaps of temperature took."""
    taken = f"is taken for {sets:.0f} data sets" if sets else "counts as no time"
    lacking = f" {listed(left_out)} [is|are] not in the improved coefficients." if left_out else ""
    return (
        f"Without times (t_s) nobody knows how long the temperature took for its {plural(leaps, f'[leap|{leaps} leaps]')} from one data set to "
        f"the next: each {taken}, and {listed(effects)} {plural(len(effects), '[hangs|hang]')} on it."
        f"{plural(len(left_out), lacking)} Give the times."
    )


def _between_sets(first: int, last: int, others: int = 0) -> str:
    """Where a jump is, and of how many that is the largest."""
    largest = f" It is the largest of {others + 1} of this kind." if others else ""
    return f"Between data sets {first} and {last}.{largest}"


def _far_sets(sets: Sequence[int], of: int, times: float) -> str:
    return plural(
        len(sets),
        f"{len(sets)} of {of} data sets [is|are] more than {times:.2g} standard deviations of the others away from everything that the model "
        f"explains ([number|numbers] {', '.join(map(str, sets))}): too many, or too close together, to be left out as disturbed, and "
        "beside [it|them] weak effects are not seen. See whether [its rate was|their rates were] mixed up; repair or remove [it|them], "
        "and diagnose again.",
    )


def _strange_sets(sets: Sequence[tuple[int, float, float, float]]) -> str:
    """Each with its number, rate in deg/s, temperature in degC, and how far off it is in mdeg/s."""
    each = (
        f"number {number} ({rate:g} deg/s at {temp:.1f} degC, off by {off:.3g} mdeg/s)"
        for number, rate, temp, off in sets
    )
    return f"Single data sets do not belong to the rest: {'; '.join(each)}. Mislabelled, or disturbed; left out of the fit."


def _beyond_temperature(left_mdps: float, branches_mdps: float | None) -> str:
    apart = (
        ""
        if branches_mdps is None
        else f"; heating and cooling differ by {branches_mdps:.3g} mdeg/s rms at the same temperature"
    )
    return (
        f"Bias is not a function of temperature alone: after any smooth curve of temperature {left_mdps:.3g} mdeg/s rms "
        f"are left that follow time or the history of temperature{apart}."
    )


def _not_written(coordinate: str) -> str:
    return (
        f"What follows {coordinate.replace('_', ' ')} without a name is not in the improved coefficients: its evidence "
        "is weak, or a bias or scale factor that wanders explains it nearly as well."
    )


def _bias_settles(
    change: float, least: float, most: float, settling_s: float, quickest_s: float, slowest_s: float | None
) -> str:
    changes = f"The gyro's bias changes by {change:.3g} deg/s (95 %: {least:.3g} to {most:.3g}) after the start of the log, "
    if slowest_s is None:
        return (
            f"{changes}for longer than the drive tells (time constant {quickest_s:.0f} s or more): the change is that to an end which is not seen, and "
            "gyro bias is what it would be there. A gyro that warms up does that, and one whose bias drifts; nothing else explains it as well, and no "
            "robot file holds it"
        )
    return (
        f"{changes}as that of a gyro does that warms up by itself (time constant {settling_s:.0f} s, 95 %: {quickest_s:.0f} to {slowest_s:.0f}), "
        "and nothing else explains it as well. A rest at the start takes off what it was then, and no robot file holds the rest: let the gyro warm "
        "up before a drive."
    )


def _sides_differ(
    change: float,
    least: float,
    most: float,
    or_moving_dps: tuple[float, float] | None,
    filed: bool,
    told: bool,
) -> str:
    larger = f"{change:.3g} % (95 %: {least:.3g} to {most:.3g}) larger in turns to the left than in turns to the right"
    if or_moving_dps is None:
        held = "the robot file has it" if filed else "that is not sure enough for a robot file"
        return f"By the truth the gyro's scale factor is {larger}; {held}"
    value, std = or_moving_dps
    return (
        f"By the truth either the gyro's scale factor is {larger}, or its bias is {value:+.2g} deg/s "
        f"(95 %: {value - NORMAL_95 * std:+.2g} to {value + NORMAL_95 * std:+.2g}) another while the robot moves: this drive does not tell which{', and the latter, which more gyros have, is what is told' if told else ''}. "
        "Turn as much to either side, go straight for longer, or log a better truth"
    )


def _truth_sensor(
    lever_ahead: tuple[float, float] | None = None,
    lever_left: tuple[float, float] | None = None,
    clock: tuple[float, float] | None = None,
) -> str:
    def told(figure: tuple[float, float], unit: str, positive: str, negative: str) -> str:
        value, std = figure
        return f"{abs(value):.3g} ± {std:.1g} {unit} {positive if value > 0.0 else negative}"

    places = [
        *([told(lever_ahead, "m", "ahead", "behind")] if lever_ahead else []),
        *([told(lever_left, "m", "to the left", "to the right")] if lever_left else []),
    ]
    where = [f"is of a point {' and '.join(places)} of the robot's middle"] if places else []
    when = [f"is {told(clock, 's', 'late', 'early')}"] if clock else []
    return f"the truth {' and '.join(where + when)}: that is taken out where paths are laid on it here; `replay` leaves it in"


def _no_sure_gain(
    chance: float, rates: int, temps: int, one_way: bool, no_gain: bool, surface_alone: bool
) -> str:
    """Counts are 0 where there are enough for a surface and a law beside it; `surface_alone`: the file would have no term."""
    reasons = {
        "all rates are of one sign, so that odd and even errors are one: record the same rates in the other direction": one_way,
        f"{rates} rates carry a cubic and no more: record more of them": rates > 0,
        f"{temps} temperatures carry a quadratic and no more: record more of them": temps > 0,
        "on data left out it gains nothing for sure: record more sweeps of the same rates": no_gain,
    }
    otherwise = (
        "none of it stays with the gyro (it is the table's, or passes), and beside it the surface is the same within its uncertainty"
        if surface_alone
        else "what of it stays with the gyro is known no better than it is large: record the same rates and temperatures again, in another order"
    )
    true = [reason for reason, holds in reasons.items() if holds] or [otherwise]
    return (
        "What was found would make another run of this gyro better than the surface alone with probability "
        f"{chance:.2f} only: no improved coefficients are written, for {'; '.join(true)}."
    )


def _no_inverse(count: int, rate_dps: float, temp_c: float) -> str:
    return (
        f"No improved coefficients are written, for with what was found {no_rate_text(count, rate_dps, temp_c)}. Record "
        "smaller rates, or leave these out, and diagnose again."
    )


def _of_scale(of_scale: bool, too: Sequence[tuple[float, float, float]], unit: str) -> str:
    """Of what else acts on the bias: what the figures are of, and what it does to the other."""
    what = "the scale factor (what it adds at 100 deg/s)" if of_scale else "the bias"
    if not too:
        return f"It acts on {what}."
    value, low, high = too[0]
    other = "the bias" if of_scale else "the scale factor, at 100 deg/s"
    return f"Its amplitude is that on {what}; on {other}, it adds {value:.3g} {unit} (95 %: {low:.3g} to {high:.3g})."


def _largest_rates(rates: Sequence[tuple[float, float, float]]) -> str:
    """Each with its error in ppm and the standard deviation of that."""
    each = [f"{rate:.4g} deg/s ({error:+.0f} +- {std:.0f} ppm)" for rate, error, std in rates]
    return f"The errors are largest at {listed(each)}."


def _clock(ppm: float) -> str:
    return (
        f"Samples arrive {abs(ppm):.0f} ppm {'later' if ppm > 0 else 'sooner'} than the nominal sample rate says: the "
        "sample clock is off, and an output that is an angle per sample is scaled by as much."
    )


def _gyro_column(unit: str, inverted: bool) -> str:
    what = {"": "", "rad/s": "in rad/s", "deg/h": "in deg/h", "twice": "converted to degrees twice"}[unit]
    turned = "with the sign inverted, or left and right wheel are swapped" if inverted else ""
    said = " and ".join(text for text in (what, turned) if text)
    return f"The gyro column is {said} (its turns over those of the encoders)."


#: What each remark says: a template of its facts, with ``[one|more]`` by their count, or a function of them.
WORDS: Mapping[Said, str | Callable[..., str]] = {
    Said.FAILED_SEGMENTS: "{count} [segment is|segments are] marked failed in the journal and left out",
    Said.SET_ASIDE_AFTER_STEPS: "{count} [sample that stands|samples that stand] out right after a step of rate [is|are] left out",
    Said.UNUSABLE_SAMPLES: "{count} gyro [sample is|samples are] empty or of bad status and left out",
    Said.MISSING_SAMPLES: "{count} [sample is|samples are] missing: the times leap by whole multiples of the sample interval",
    Said.STRAY_SAMPLES: "{count} [sample stands|samples stand] out of the noise by more than six standard deviations; left out",
    Said.WHOLE_DEGREES: "temperatures are whole degrees (nominal, or of a coarse sensor): an error of 0.29 degC rms, "
    "which blurs what lives in temperature and hides what lives in its rate",
    Said.CHAMBER_FOR_GYRO: "the gyro sends no temperature: the chamber's stands for its own, behind which the gyro lags",
    Said.ONE_WAY: lambda rose: (
        f"the temperature {'rose' if rose else 'fell'} all along: what time alone did to bias or scale factor stands in the surface as "
        "if it were the temperature's, and in no stated uncertainty; heat and cool more than once"
    ),
    Said.FEW_TEMPERATURES: _few_temperatures,
    Said.SMOOTHED: "temp_c scatters by {rms_c:.2g} degC rms about a smooth course, which stands in its place: the output does not show that it follows the scatter",
    Said.NOMINAL_RATES: "rate_dps scatters by {rms_dps:.2g} deg/s rms about {rates} rates, which stand in its place: the output {does} the scatter",
    Said.DITHERED: "the temperatures are means of readings in steps of {step_c:g} degC that noise carries to and fro, nearer to the steps "
    "than the temperature is: its course between them is taken instead; log the readings, or a finer thermometer",
    Said.SAME_TIMES: "{count} [row has|rows have] the time of the row before: check the times",
    Said.SLIP_OF_OWN_TRACK: "The figures of the slip above are shares of the wheel separation that the robot file gives; improved_robot.toml has "
    "it as a share of its own, {separation_m:.4g} m: {percent:.3g} % ({law}).",
    Said.SHARED_TIMES: "{count} [row has|rows have] the time of the row before; rows of one time are taken as following each other evenly "
    "until the next: log times of their own",
    Said.NO_SPREAD: "gyro_std_dps is 0 in {count} [row|rows] of several samples: an output that is stuck or does not resolve "
    "its noise; [it counts|they count] as noisy as the others",
    Said.STRAY_SETS: _stray_sets,
    Said.SCALE_FAR_OFF: "the output is {ratio:.3g} times the rate: far more than a gyro's scale error, and the fitted "
    "surface takes it up; check scale and units",
    Said.LEFT_OUT_SETS: "whole data sets (every eighth segment) and whole temperatures or sweeps in turn",
    Said.LEFT_OUT_BLOCKS: "every {folds}th block of {block_s:g} s",
    Said.TEMPERATURE_ALONE: "Bias is a function of temperature alone, as far as this record can tell.",
    Said.NOT_TEMPERATURE_ALONE: _beyond_temperature,
    Said.NOT_WRITTEN: _not_written,
    Said.LAW_NOT_WRITTEN: "The improved coefficients have no {effect}, though it is named: they are the mean of models that are about as "
    "likely, and those have other laws, curves or errors of single rates in its place.",
    Said.ALSO_WRITTEN: lambda effects: (
        f"The improved coefficients have {listed(effects)}, too, without a name: models that are nearly as likely do, and the file is the "
        "mean of all, with that uncertainty."
    ),
    Said.SINE_WRITTEN: "The improved coefficients have the sine of an open loop, whose phase at {rate_dps:.4g} deg/s is {phase_rad:.3f} "
    "± {std_rad:.2g} rad: its cubic is the one that the rates show, and its higher orders, which errors of single rates hide, cannot be "
    "checked on this table.",
    Said.BEFORE_SINE: lambda effects, rate_dps, share: (
        f"What {listed(effects)} {'do' if len(effects) > 1 else 'does'} to the scale factor comes before the sine of the "
        f"open loop: at {rate_dps:.4g} deg/s its figures count {share:.2f} times, as an output that bends has that slope there."
    ),
    Said.OPEN_SINCE_POWER_ON: "Whether the change of the bias since power-on comes again is open (a warm-up with "
    "probability {again:.2f}, else a drift): the improved coefficients have the mean of both. Record a second power-on.",
    Said.EDGE: _edge,
    Said.STATE_AT_END: lambda effects: (
        f"Of {listed(effects)} the improved coefficients have the state at the end of the record: where that does not last to the next "
        "run, as through a switch-off, they are off by it. Record again after one."
    ),
    Said.NOT_LOGGED_MEANWHILE: lambda effects, pauses, longest_min, most_c: (
        f"Between data sets the temperature was not logged ({plural(pauses, f'[one pause|{pauses} pauses]')}, up to {longest_min:.0f} min and "
        f"{most_c:.0f} °C): size and time constant of {listed(effects)} hang on its course there, which is taken for smooth, and their "
        "intervals know nothing of that. Log it all the time."
    ),
    Said.LATER_ON_A_ROBOT: lambda effects, late_s, late_dps: (
        f"A robot derives the temperature's rate from what it has read by then, {late_s:.0f} s late: applied so, the improved coefficients "
        f"leave {dph(late_dps)} deg/h rms of {listed(effects)} on this record, which figures of data left out do not have."
    ),
    Said.GIVE_TIMES: _give_times,
    Said.WANDERS: "The bias wanders by {slow_mdps:.2g} mdeg/s rms, by more than data sets scatter by themselves ({fast_mdps:.2g}): that is taken "
    "for 1/f noise, and steps, drifts and shapes over temperature of that size hide in it. Go through the same temperatures more than once.",
    Said.MEAN_OF_DRIFT: lambda effects: (
        f"Of {listed(effects)} the improved coefficients have the mean over the record, and what it adds about that in their standard "
        "deviations: where it will stand nobody knows."
    ),
    Said.INPUT_ALREADY: lambda alone: (
        "The surface is one of the true rate already: there is nothing to add to it"
        + (", and no improved coefficients are written." if alone else " for fit_direction.")
    ),
    Said.NO_SURE_GAIN: _no_sure_gain,
    Said.NO_INVERSE: _no_inverse,
    Said.TOO_FEW_TO_WRITE: "It has {rows} data sets, in which one law may pass for another: what is found is told, but improved "
    "coefficients are written from {enough} on.",
    Said.TOO_FEW_RATES: "It has {rates} rates, between which a cubic may do anything: what is found is told, but improved "
    "coefficients are written from {enough} on.",
    Said.DEAD_SETS: "The output is exactly 0 in {count} of {sets} data sets where the others say up to {lost_mdps:.3g} "
    "mdeg/s: small outputs are lost (dead zone, lock-in). [That data set is|Those data sets are] left out of the fit.",
    Said.CLIPPED: "The output stands still in {count} of {sets} data sets, from {least_dps:.4g} deg/s on: the gyro is clipped there, and "
    "no coefficients tell these rates apart. [That data set is|Those data sets are] left out of the fit.",
    Said.STRANGE_SETS: _strange_sets,
    Said.FAR_SETS: _far_sets,
    Said.BURST_SAMPLES: "{count} of {samples} samples [stands|stand] out of the noise by more than six standard deviations "
    "(bursts, slip ring).",
    Said.OUTPUT_STEPS: "The output comes in steps of {step_mdps:.4g} mdeg/s, which adds {noise_mdps:.3g} mdeg/s of noise "
    "to a sample.",
    Said.LOST_IN_STEPS: "The steps of the output hide its noise: a data set may be off by {hidden_mdps:.3g} mdeg/s, and what "
    "was found that is smaller is not told from rounding: it is neither named nor corrected. Log finer samples.",
    Said.SAMPLE_CLOCK: _clock,
    Said.BETWEEN_SETS: _between_sets,
    Said.SEVERAL_LAWS: "It takes {count} of this kind, one over the other; the figures are those of the largest.",
    Said.OF_SCALE: _of_scale,
    Said.LARGEST_RATES: _largest_rates,
    Said.GAPS: "{count} [gap|gaps] of more than {steps:g} usual steps [is|are] left out, the longest of {longest_s:.3g} s at {at_s:.6g} s",
    Said.EMPTY_WHEEL: "{count} [row|rows] without {wheel} [is|are] bridged by the speed of that wheel before and after, and left out of the comparison",
    Said.CALIBRATED: "the gyro was calibrated with the coefficients given",
    Said.GYRO_BRIDGED: "{count} [row|rows] without gyro [is|are] bridged by [its|their] neighbours",
    Said.GYRO_SPIKES: "{count} [spike|spikes] of the gyro, up to {largest_dps:.3g} deg/s, [is|are] bridged in the comparison",
    Said.TRUTH_UNIT: "the truth's positions are {times:g} times too large: they are taken in {unit}",
    Said.TRUTH_RADIANS: "the truth's heading is in radians: it is taken as such",
    Said.TRUTH_CLOCKWISE: "the truth's heading turns clockwise, as a compass's does, and is taken as such",
    Said.TRUTH_SENSOR: _truth_sensor,
    Said.TRUTH_MIRRORED: "the truth follows the path in a mirror only (y and x swapped, y or the gyro of the wrong sign?), "
    "so it was left aside",
    Said.UNEVEN_CLOCK: "time stamps scatter by {jitter_ms:.2g} ms about an even clock of {usual_ms:.3g} ms",
    Said.GYRO_COLUMN: _gyro_column,
    Said.WHEELS_SWAPPED: "Left and right wheel are swapped: the truth turns as the gyro does.",
    Said.WHEEL_SIGN: "The {side} wheel counts backwards: its sign is inverted.",
    Said.MISSING_ROWS: "About {count} [row is|rows are] missing ({percent:.2g} % of the log, the longest gap {longest_s:.3g} s).",
    Said.CREEPS: "where the speed is least the gyro is still, at another rate than its bias while it drives: it creeps there in an even bend, and "
    "no rest is taken of it",
    Said.STANDS: "the speed reads up to {most_mps:.2g} m/s where the gyro is as still as its own noise: {total_s:.0f} s are taken as rests",
    Said.NO_REST: "The rest at the start that the robot file promises with static_s is not in this log, and `replay` refuses it: {why}",
    Said.WAYS_ADDED: "The way of the wheels is missing with rows, since the row after holds that of one row: {way_m:.3g} m are added at its speed.",
    Said.WHEEL_TURN: "The {side} wheel's distance is modulated every {way_m:.3g} m, once a turn of a wheel of radius "
    "{radius_m:.3g} m.",
    Said.ENCODERS_LATE: "The encoders' counts arrive later than the gyro's rate (a negative delay).",
    Said.SAMPLES_OF_ROWS: "The gyro is early by half a row, within a fifth of one: so it is where a row has its sample and not its "
    "mean (what it turned between rows is lost then: log the mean rate since the row before, or more rows), and where the encoders "
    "average or come late.",
    Said.MEANS_OF_ROWS: "Where rows hold the mean rate since the row before, as `replay` takes them (samples: {half_row_s:.2g} s more)",
    Said.TURNS_INWARD: "In turns the encoders see less than the gyro: the robot turns as if its wheels stood closer "
    "together than the robot file says.",
    Said.BIAS_IN_MOTION: "In motion the gyro's bias differs from that of the rest at the start.",
    Said.BIAS_WHILE_MOVING: "While the robot moves the gyro's bias differs from its bias at rest, as when vibration reaches it.",
    Said.BIAS_NO_REST: "The gyro has a bias that no rest at the start takes off.",
    Said.BIAS_SETTLES: _bias_settles,
    Said.SIDES_DIFFER: _sides_differ,
    Said.TEMPERATURE_OR_TIME: "Temperature and time went together: that the bias drifts by itself is {odds:.2g} times as likely as that it goes by the "
    "temperature, and a robot file gets {share:.0%} of the slope. Drive once more from another temperature",
    Said.BIAS_JUMPS: "The gyro's bias jumps by {change:.3g} deg/s (95 %: {least:.3g} to {most:.3g}) at {until_s:.0f} s (95 %: "
    "{earliest_s:.0f} to {latest_s:.0f}) and stays there; gyro bias is that of the end. A robot file that has to hold the bias gets one "
    "between both, for nobody knows which is next",
    Said.WHEELS_CHANGE: "From {until_s:.0f} s on (95 %: {earliest_s:.0f} to {latest_s:.0f}) the distance counted by the right wheel, relative "
    "to the left, changes by {change:.3g} % (95 %: {least:.3g} to {most:.3g}): a wheel that counts more has become smaller (air, wear, "
    "load); no robot file holds that",
    Said.TRACK_CHANGES: "From {until_s:.0f} s on (95 %: {earliest_s:.0f} to {latest_s:.0f}) the encoders' turns are others by {change:.3g} % "
    "(95 %: {least:.3g} to {most:.3g}), as on another ground; no robot file holds that",
    Said.DELAY_GROWS: "What the gyro is late against the encoders changes by {change:.3g} ms (95 %: {least:.3g} to {most:.3g}) in this "
    "drive, as by clocks that run apart: no delay of a robot file holds that",
    Said.TRACK_MIXED_UP: "About half or twice the wheel separation: see whether the file holds half a track or a tread "
    "for a track.",
}


#: What the data lack, and what was done about it: no findings.
_OF_THE_DATA = frozenset(
    {
        Said.FAILED_SEGMENTS,
        Said.SET_ASIDE_AFTER_STEPS,
        Said.UNUSABLE_SAMPLES,
        Said.STRAY_SAMPLES,
        Said.WHOLE_DEGREES,
        Said.DITHERED,
        Said.SMOOTHED,
        Said.NOMINAL_RATES,
        Said.CHAMBER_FOR_GYRO,
        Said.SAME_TIMES,
        Said.SHARED_TIMES,
        Said.NO_SPREAD,
        Said.GAPS,
        Said.WAYS_ADDED,
        Said.STANDS,
        Said.CREEPS,
        Said.NO_REST,
        Said.EMPTY_WHEEL,
        Said.CALIBRATED,
        Said.GYRO_BRIDGED,
        Said.GYRO_SPIKES,
        Said.UNEVEN_CLOCK,
        Said.TRUTH_UNIT,
        Said.TRUTH_RADIANS,
        Said.TRUTH_CLOCKWISE,
    }
)


def of_the_data(note: Note) -> bool:
    """Whether a note is about the data and not about the gyro; so are those of readers, which come as texts."""
    return not isinstance(note, Remark) or note.said in _OF_THE_DATA


def remark_words(note: Note) -> str:
    """A remark in words; what a reader has said stays as it is."""
    if not isinstance(note, Remark):
        return note
    words = WORDS[note.said]
    if not isinstance(words, str):
        return words(**note.facts)
    return plural(note.facts.get("count", 0), words).format(**note.facts)


def statement(effect: NamedEffect) -> str:
    """What a named effect is: what was seen of it here, or what the catalogue says of it."""
    seen = described(effect.effect).statement if effect.seen is None else remark_words(effect.seen)
    return seen if effect.beside is None else f"{seen} {remark_words(effect.beside)}"
