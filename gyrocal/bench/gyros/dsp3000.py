"""KVH DSP-3000, digital 100 Hz (02-1222-01): ASCII lines at 38400 8N1 (protocols.md 1.2).

A line is 19 characters and CR LF: a right-justified number with six decimals and the BIT word, 1 when the data are
valid. There is no checksum, temperature or counter, so the fixed width is the only guard against a cut number.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from gyrocal.bench.gyros.codec import GOOD, Frame, LineDecoder

LINE_CHARACTERS = 19
#: Beyond this the data are unreliable whatever the BIT word says (manual 54-0215).
MAX_TRUSTED_DPS = 375.0
#: Switches to rates; nothing is answered, so it is sent three times (as kvh_drivers does).
COMMAND_RATE = b"R"

STATUS_FAULT = 1
STATUS_OVER_RANGE = 2

_LINE = re.compile(rb" +(-?\d{1,3}\.\d{6}) +([01])")


@dataclass(frozen=True)
class Options:
    """What the wire does not tell: the maker counts clockwise as positive, by one source."""

    counter_clockwise_positive: bool = False


class Dsp3000Decoder(LineDecoder):
    """Bytes of a DSP-3000 in rate mode to frames."""

    max_line = 64

    def __init__(self, options: Options = Options()) -> None:
        super().__init__()
        self._sign = 1.0 if options.counter_clockwise_positive else -1.0

    def _parse(self, line: bytes) -> Frame | None:
        match = _LINE.fullmatch(line)
        if match is None or len(line) != LINE_CHARACTERS:
            return None
        rate_dps = float(match[1])
        status = GOOD if match[2] == b"1" else STATUS_FAULT
        if abs(rate_dps) > MAX_TRUSTED_DPS:
            status |= STATUS_OVER_RANGE
        return Frame(self._sign * rate_dps, status=status, raw=line)


def encode(rate_dps: float, *, valid: bool = True, options: Options = Options()) -> bytes:
    """Line of a rate, deg/s.

    Raises
    ------
    ValueError
        The rate has more than three digits before the point.
    """
    if not abs(rate_dps) < 999.9999995:
        raise ValueError(f"{rate_dps} deg/s does not fit the line of a DSP-3000")
    sign = 1.0 if options.counter_clockwise_positive else -1.0
    return f"{sign * rate_dps:15.6f}{int(valid):4d}\r\n".encode()
