"""One error base, few subclasses, each mapped to an exit code in one place.

A message is one sentence or two: what happened, where (file, line, rate, temperature) and what to do.
"""


class GyrocalError(Exception):
    """Base of every error that gyrocal raises on purpose; its text is shown to the user as it is."""


class InputError(GyrocalError):
    """A file is missing, unreadable, truncated, of a wrong schema or unit, or holds a bad value."""


class DataError(GyrocalError):
    """The file is sound, but its data cannot carry what was asked."""


class ProfileError(GyrocalError):
    """A bench profile or robot file has a bad key or value."""


class CoefficientError(GyrocalError):
    """A coefficient file is edited, truncated, newer than this program, or of another sensor."""


class OutputError(GyrocalError):
    """The output exists already, cannot be written, or the disk is full."""


class LimitError(GyrocalError):
    """A plan asks for more than gyro, table, chamber or user allow; nothing has moved."""


class DeviceError(GyrocalError):
    """A device on the bench does not answer, answers wrongly, or reports a fault."""


class InterlockError(GyrocalError):
    """An interlock has tripped and latched; the bench was made safe."""


class StopNotVerifiedError(GyrocalError):
    """The table was told to stop and its read-back does not confirm that it stands."""


class IncompleteError(GyrocalError):
    """The run ended safely, but segments failed or were skipped; the summary says which."""


class OutOfLimitsError(GyrocalError):
    """A unit was measured, and a figure lies beyond its limit with all of its uncertainty."""


class InterruptedRunError(GyrocalError):
    """The operator (Ctrl-C) or the system (SIGTERM, SIGHUP) ended the run; it can be resumed."""


#: 0 is success, 2 is click's own usage error, 1 is left for what nobody foresaw (a bug).
EXIT_CODES: dict[type[GyrocalError], int] = {
    InputError: 3,
    DataError: 4,
    ProfileError: 5,
    CoefficientError: 6,
    OutputError: 7,
    LimitError: 8,
    DeviceError: 9,
    InterlockError: 10,
    StopNotVerifiedError: 11,
    IncompleteError: 12,
    OutOfLimitsError: 13,
    InterruptedRunError: 130,
}


def exit_code(error: GyrocalError) -> int:
    """Exit code of an error: that of its nearest listed class, 1 when none is listed."""
    for cls in type(error).__mro__:
        if cls in EXIT_CODES:
            return EXIT_CODES[cls]
    return 1
