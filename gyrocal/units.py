"""Constants with their units, and how counts and uncertain numbers are said. One definition each, used everywhere."""

import math
import re

#: Seconds in an hour, minutes in an hour, seconds in a minute.
S_PER_H = 3600.0
S_PER_MIN = 60.0

#: Turn rate of the Earth relative to the stars, deg/h (IERS: 7.292115e-5 rad/s).
EARTH_RATE_DPH = 15.04106864

#: deg/h to deg/s, and back.
DPH_TO_DPS = 1.0 / S_PER_H
DPS_TO_DPH = S_PER_H

#: Angle random walk: deg/sqrt(h) to deg/sqrt(s), that is deg/s/sqrt(Hz). N_s = N_h / sqrt(3600 s/h).
DEG_PER_RT_H_TO_DPS_PER_RT_HZ = 1.0 / 60.0

#: Degrees to radians and back.
DEG_TO_RAD = 0.017453292519943295
RAD_TO_DEG = 57.29577951308232

#: mdeg/s to deg/s, parts per million to a share.
MDPS = 1e-3
PPM = 1e-6

#: Arc-seconds to degrees.
ARCSEC_TO_DEG = 1.0 / 3600.0

#: Half of a 95 % interval of a normal law, in standard deviations.
NORMAL_95 = 1.959963984540054

#: Standard deviations of a normal law in its median absolute deviation.
STDS_PER_MAD = 1.4826

#: Below this a p-value is a matter of the tail that was assumed, not of the data.
_LEAST_P = 1e-12

_FORMS = re.compile(r"\[([^][|]*)\|([^][|]*)\]")


def plural(count: int, text: str) -> str:
    """`text` said of so many: of each ``[one|more]`` the part that fits."""
    return _FORMS.sub(r"\1" if count == 1 else r"\2", text)


def dph(value_dps: float | None) -> str:
    """A rate in deg/h, three digits at least, thousands set off."""
    if value_dps is None:
        return "unknown"
    value = value_dps * DPS_TO_DPH
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def decimals(half_width: float) -> int:
    """Decimals that show two digits of a half width; negative: tens, hundreds."""
    return 1 - math.floor(math.log10(half_width)) if half_width > 0 and math.isfinite(half_width) else 3


def p_text(p: float) -> str:
    """``< 1e-12`` or the number: a p-value as people read it."""
    return f"< {_LEAST_P:.0e}" if p < _LEAST_P else f"{p:.2g}" if math.isfinite(p) else "not known"


def p_equals(p: float) -> str:
    """The same in a sentence: ``p < 1e-12`` or ``p = 0.0054``."""
    return f"p {p_text(p)}" if p < _LEAST_P else f"p = {p_text(p)}"
