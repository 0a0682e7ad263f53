"""Request and answer over a port: one exchange at a time, each with a deadline for the whole of it.

Devices answer in the order in which they are asked, but few of their protocols number what they say. So an answer is
taken only when its form fits the question; and whenever an answer may be under way that nobody waits for (a time-out,
a command that was not waited for, bytes that nobody asked for), the next question is preceded by a resynchronising
one, whose answer looks like no other's: once it is here, all that was owed before it is here too, and dropped.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from gyrocal.bench.transport import Transport
from gyrocal.errors import DeviceError

T = TypeVar("T")

#: No device here says more at once.
_LONGEST_ANSWER = 8192
#: Bytes that nobody asked for are late answers, and end soon. A line that still brings some after this time, or has
#: brought so many, talks by itself.
_QUIET_WITHIN_S, _MOST_UNASKED = 0.2, 1 << 16
#: Bytes that come over more than this share of the time of an exchange are no answer: those come in one piece.
_TALKING_SHARE = 0.5
#: Without a byte for so long a line is quiet.
_QUIET_S = 0.02
_CHECK = "Check power, cable, baud rate and address."

#: Cuts the first whole answer off the front of what came: ``(answer, rest)``, or None while there is none.
Cut = Callable[[bytes], tuple[bytes, bytes] | None]
#: The answer that fits a question, decoded; None: this is no answer to it. Raises DeviceError for a refusal.
Accept = Callable[[bytes], T | None]


def ended_by(terminator: bytes) -> Cut:
    """Answers that end with a terminator, which is cut off."""

    def cut(data: bytes) -> tuple[bytes, bytes] | None:
        answer, end, rest = data.partition(terminator)
        return (answer, rest) if end else None

    return cut


class Conversation:
    """Exchanges with one device.

    Parameters
    ----------
    cut : callable
        Tells answers apart, see `ended_by`.
    timeout_s : float
        Deadline of an exchange, and of the resynchronising one that may precede it.
    sync : (bytes, callable), optional
        A question that changes nothing, and what tells its answer from those to all others. None where requests are
        numbered, or where a late answer does no harm.
    """

    def __init__(
        self,
        transport: Transport,
        name: str,
        cut: Cut,
        timeout_s: float,
        sync: tuple[bytes, Accept[bool]] | None = None,
    ) -> None:
        self.transport = transport
        self._name = name
        self._cut = cut
        self._timeout_s = timeout_s
        self._sync = sync
        self._buffer = b""
        # who used the port before may have left a question open
        self._in_step = False

    def send(self, data: bytes) -> None:
        """Send a command whose answer nobody waits for."""
        self._in_step = False
        self.transport.write(data)

    def tell(self, data: bytes) -> None:
        """Send a command that the device does not answer."""
        self.transport.write(data)

    def ask(self, request: bytes, accept: Accept[T]) -> T:
        """Send `request` and return its answer; what came before is dropped.

        Raises
        ------
        DeviceError
            No answer that fits within the deadline, a refusal, or a line that talks by itself (nothing is sent then).
        """
        self._drop_unasked()
        if self._sync is not None and not self._in_step and request != self._sync[0]:
            self._exchange(*self._sync)
        return self._exchange(request, accept)

    def _exchange(self, request: bytes, accept: Accept[T]) -> T:
        self._in_step = False  # until its answer is here
        self.transport.write(request)
        answer = self._awaited(request, accept)
        self._in_step = True
        return answer

    def _drop_unasked(self) -> None:
        """Drop what came since the last answer; raise where that does not end."""
        count, self._buffer = len(self._buffer), b""
        deadline_s = self.transport.now_s() + _QUIET_WITHIN_S
        data = self.transport.read_available(0.0 if self._in_step else _QUIET_S)
        while data:
            count += len(data)
            if self.transport.now_s() >= deadline_s or count >= _MOST_UNASKED:
                raise DeviceError(self._talks(count))
            data = self.transport.read_available(_QUIET_S)
        if count:
            self._in_step = False

    def _awaited(self, request: bytes, accept: Accept[T]) -> T:
        """The first answer that fits; others are dropped until the deadline."""
        deadline_s = self.transport.now_s() + self._timeout_s
        strays: list[bytes] = []
        heard_s: list[float] = []
        while True:
            while (found := self._cut(self._buffer)) is not None:
                answer, self._buffer = found
                if (result := accept(answer)) is not None:
                    return result
                strays.append(answer)
            left_s = deadline_s - self.transport.now_s()
            came = len(self._buffer) + sum(map(len, strays))
            if left_s <= 0 or came > _LONGEST_ANSWER:
                if heard_s and heard_s[-1] - heard_s[0] > _TALKING_SHARE * self._timeout_s:
                    raise DeviceError(self._talks(came))
                raise DeviceError(self._failed(request, strays))
            data = self.transport.read_available(min(left_s, 0.1))
            if data:
                self._buffer += data
                heard_s.append(self.transport.now_s())

    def _talks(self, count: int) -> str:
        return (
            f"{self._name}: this port talks by itself ({count} bytes that nobody asked for): a gyro? "
            "Check that the ports of gyro, table and chamber are not exchanged, and the cable."
        )

    def _failed(self, request: bytes, strays: list[bytes]) -> str:
        """What came in the place of an answer."""
        asked = f"to {_shown(request)} within {self._timeout_s:g} s"
        if strays:
            count = f"{len(strays)} others, the first" if len(strays) > 1 else "one that does not fit it,"
            return f"{self._name}: no answer {asked}, but {count} {_shown(strays[0])}. Check cable, baud rate and options."
        if len(self._buffer) > _LONGEST_ANSWER:
            return f"{self._name}: {len(self._buffer)} bytes came and no end of an answer {asked}. Check the baud rate."
        said = f"half an answer ({_shown(self._buffer)})" if self._buffer else "no answer"
        return f"{self._name}: {said} {asked}. {_CHECK}"


def _shown(data: bytes) -> str:
    """Text as text, frames in hexadecimal digits."""
    data = data[:60]
    printable = all(32 <= byte < 127 or byte in b"\r\n" for byte in data)
    return repr(data.decode("ascii")) if printable else data.hex(" ")
