"""Words of the reasons why a record cannot show an effect."""

from __future__ import annotations

from collections.abc import Mapping

from gyrocal.physics.lacking import Lack, Reason, Why

#: What each reason says: a template of its facts.
WORDS: Mapping[Why, str] = {
    Why.NO_TURN: "the table did not turn",
    Why.ONE_RATE: "it turned at one rate only, where what changes the scale factor changes the output as the bias does",
    Why.FEW_RATES: "it has {count} different rates, and shapes in rate need at least {fewest}",
    Why.FEW_FOR_EVEN: "it has {count} sizes of rate, rest among them, and shapes that are even in the rate need at least {fewest}",
    Why.FEW_FOR_PEAK: "it has {count} sizes of rate, rest among them, and a peak over the rate needs at least {fewest}",
    Why.FEW_SIZES: "it turns at {count} sizes of rate, and shapes that are odd in the rate need at least {fewest}",
    Why.ONE_WAY: "it turns one way only",
    Why.NO_REST: "it has no data at rest",
    Why.NO_STEPS: "the record has no samples after a step of rate",
    Why.LATE: "the record begins more than {hours:g} h after power-on",
    Why.STEADY_TEMPERATURE: "the temperature changed by less than {by_c:g} degC",
    Why.ONE_BRANCH: "the temperature did not both rise and fall by {by_c:g} degC",
    Why.NO_CHANNEL: "the record has no {channel}",
    Why.CONTINUOUS: "the samples of the output lie on no lattice, as those that are cut to steps do",
    Why.ANGLE_NOT_LOGGED: "the table angle was not logged with every segment",
    Why.SUPPLY_NOT_LOGGED: "the supply voltage was not logged with every segment",
    Why.STEADY_SUPPLY: "the supply voltage did not change",
    Why.NO_POWER_ON: "run.json does not say when the gyro was powered on",
    Why.TABLE_NO_ANGLE: "a table of data sets carries no table angle",
    Why.TABLE_NO_SUPPLY: "a table of data sets carries no supply voltage",
    Why.TABLE_NO_POWER_ON: "a table of data sets does not say when the gyro was powered on",
    Why.TABLE_NO_SAMPLES: "a table of data sets carries no samples",
    Why.UNTIMED_ORDER: "the table has no t_s; the order of the data sets stands for time",
    Why.NO_INCLINATION: "the log has no inclination",
    Why.LIKE_GYRO_BIAS: "it cannot be told from a gyro bias",
    Why.MOMENTS_ONLY: "it changes distances for moments only, and neither turns nor way show wheels that go further while the speed grows",
    Why.SINGLE_BUMPS: "single bumps cannot be told from the wheels' noise, nor many of them from a scale of the wheels",
    Why.NO_GYRO_TEMPERATURE: "the log has no gyro temperature, or it hardly changes",
    Why.NO_REST_AT_START: "the log does not begin with a rest: a bias is seen, but not that in motion less that at rest",
    Why.ONE_SPEED: "both wheel columns hold one speed, so that nothing but the truth speaks of turns",
    Why.LIKE_SEPARATION: "without true positions it cannot be told from the effective wheel separation",
    Why.LIKE_WAY: "without true positions it cannot be told from the true way",
    Why.POOR_TRUTH: "with this truth it is known to {percent:.2g} % only",
}


def reason_words(reason: Reason) -> str:
    """A reason in words; what an effect from outside says stays as it is."""
    return WORDS[reason.why].format(**reason.facts) if isinstance(reason, Lack) else reason
