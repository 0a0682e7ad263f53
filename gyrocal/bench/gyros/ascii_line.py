"""Any gyro that sends a line of text a sample: columns by number, or a regular expression with named groups."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from gyrocal.bench.gyros.codec import GOOD, Frame, LineDecoder
from gyrocal.bench.schema import choice, number
from gyrocal.errors import ProfileError
from gyrocal.units import DPH_TO_DPS, MDPS, RAD_TO_DEG

#: Factors to deg/s by the unit's name in the profile.
RATE_UNITS = {"deg/s": 1.0, "rad/s": RAD_TO_DEG, "mdeg/s": MDPS, "deg/h": DPH_TO_DPS, "counts": 1.0}
GROUPS = ("rate", "temp", "status", "sequence")


@dataclass(frozen=True)
class Options:
    """How to read a line.

    Attributes
    ----------
    columns : tuple of str
        Names of the columns in order; ``rate`` is required, ``temp``, ``status``, ``sequence`` are used, any other
        name is skipped. Ignored where `pattern` is given.
    separator : str
        Between columns; blank means any run of white space.
    pattern : str
        Regular expression that must match the whole line, with a named group ``rate`` and perhaps the others.
    rate_unit : str
        One of `RATE_UNITS`.
    rate_scale : float
        Multiplies the number before the unit (counts: deg/s a count; a negative scale turns the sign); not 0.
    status_good : float
        Value of ``status`` that means good.
    sequence_modulus : int or None
        Values of the counter before it returns to 0.
    """

    columns: tuple[str, ...] = ("rate",)
    separator: str = ","
    pattern: str = ""
    rate_unit: str = choice(*RATE_UNITS, default="deg/s")
    rate_scale: float = 1.0
    status_good: float = 0.0
    sequence_modulus: int | None = number(2, 2**32, "", None)


class AsciiLineDecoder(LineDecoder):
    """Bytes of lines to frames; a line that does not fit the description is counted as bad."""

    def __init__(self, options: Options) -> None:
        super().__init__()
        if options.rate_scale == 0.0:
            raise ProfileError(
                "gyro.options.rate_scale is 0, and every rate would be. Give deg/s, or the unit, a count."
            )
        self._options = options
        self.sequence_modulus = options.sequence_modulus
        self._scale = options.rate_scale * RATE_UNITS[options.rate_unit]
        self._pattern = _compile(options)

    def _parse(self, line: bytes) -> Frame | None:
        try:
            match = self._pattern.fullmatch(line.decode("ascii").strip())
        except UnicodeDecodeError:
            return None
        if match is None:
            return None
        try:
            values = {
                name: float(text) for name, text in match.groupdict().items() if name in GROUPS and text
            }
        except ValueError:
            return None
        if "rate" not in values or not all(math.isfinite(value) for value in values.values()):
            return None
        good = values.get("status", self._options.status_good) == self._options.status_good
        return Frame(
            values["rate"] * self._scale,
            values.get("temp", math.nan),
            GOOD if good else int(values["status"]) or -1,
            int(values["sequence"]) if "sequence" in values else None,
            line,
        )


def _compile(options: Options) -> re.Pattern[str]:
    if options.pattern:
        try:
            pattern = re.compile(options.pattern)
        except re.error as error:
            raise ProfileError(
                f"gyro.options.pattern is not a regular expression ({error}). Repair it."
            ) from error
        if "rate" not in pattern.groupindex:
            raise ProfileError(
                "gyro.options.pattern has no group named rate; write (?P<rate>...) around the number."
            )
        return pattern
    if options.columns.count("rate") != 1 or any(options.columns.count(name) > 1 for name in GROUPS):
        raise ProfileError(
            f"gyro.options.columns must name rate once, and of {', '.join(GROUPS)} none twice."
        )
    separator = r"\s+" if not options.separator.strip() else rf"\s*{re.escape(options.separator.strip())}\s*"
    cell = r"[^\s,;]*" if not options.separator.strip() else rf"[^{re.escape(options.separator.strip())}\s]*"
    cells = [f"(?P<{name}>{cell})" if name in GROUPS else cell for name in options.columns]
    return re.compile(separator.join(cells))


def encode(options: Options, **values: float) -> bytes:
    """Line of values by column name, for a description by columns (`rate` in deg/s)."""
    scaled = values | {"rate": values["rate"] / (options.rate_scale * RATE_UNITS[options.rate_unit])}
    joiner = options.separator if options.separator.strip() else " "
    return (joiner.join(f"{scaled.get(name, 0.0):.9g}" for name in options.columns) + "\r\n").encode()
