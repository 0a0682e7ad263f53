"""Modbus RTU frames, as far as two chambers need them: functions 3, 6 and 16 (protocols.md 3.2).

An answer to a read says how many words it holds, and not of which register: where one may be owed, a number of words
is read first that no other question asks for.
"""

from __future__ import annotations

from gyrocal.bench.clock import Clock
from gyrocal.bench.conversation import Conversation, Cut
from gyrocal.bench.transport import Transport
from gyrocal.errors import DeviceError

READ, WRITE_ONE, WRITE_MANY = 3, 6, 16
_FAILED = 0x80
_EXCEPTION_BYTES = 5
#: After a write the controller wants so long for itself.
_AFTER_WRITE_S = 0.03
_EXCEPTIONS = {
    1: "function",
    2: "address",
    3: "value",
    4: "device failure",
    5: "acknowledged, not done",
    6: "busy",
}


def crc16(data: bytes) -> bytes:
    """CRC-16/Modbus of `data`, low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return crc.to_bytes(2, "little")


def frame(body: bytes) -> bytes:
    """`body` with its CRC."""
    return body + crc16(body)


def read_request(address: int, register: int, count: int) -> bytes:
    """Request for `count` holding registers."""
    return frame(bytes([address, READ]) + register.to_bytes(2, "big") + count.to_bytes(2, "big"))


def write_request(address: int, register: int, words: list[int]) -> bytes:
    """Request that writes one word (function 6) or several (function 16)."""
    head = register.to_bytes(2, "big")
    data = b"".join((word & 0xFFFF).to_bytes(2, "big") for word in words)
    if len(words) == 1:
        return frame(bytes([address, WRITE_ONE]) + head + data)
    return frame(
        bytes([address, WRITE_MANY]) + head + len(words).to_bytes(2, "big") + bytes([len(data)]) + data
    )


def frames_of(address: int) -> Cut:
    """Cuts answers of a slave off what came: frames whose length and CRC fit; other bytes before them are dropped."""

    def cut(data: bytes) -> tuple[bytes, bytes] | None:
        for begin in range(len(data) - _EXCEPTION_BYTES + 1):
            length = _answer_length(data[begin:])
            answer = data[begin : begin + length]
            if (
                length
                and answer[0] == address
                and len(answer) == length
                and crc16(answer[:-2]) == answer[-2:]
            ):
                return answer, data[begin + length :]
        return None

    return cut


def _answer_length(data: bytes) -> int:
    """Bytes of the answer that begins here; 0 where none of the functions does."""
    function = data[1]
    if function & ~_FAILED not in (READ, WRITE_ONE, WRITE_MANY):
        return 0
    if function & _FAILED:
        return _EXCEPTION_BYTES
    return 5 + data[2] if function == READ else 8


class ModbusMaster:
    """One slave on one line. Reads are repeated once; writes never are: whoever writes reads back.

    Parameters
    ----------
    sync : (int, int)
        Register and number of words of the resynchronising question; see `Conversation`.
    """

    def __init__(
        self,
        transport: Transport,
        clock: Clock,
        name: str,
        address: int,
        timeout_s: float,
        sync: tuple[int, int],
    ) -> None:
        register, count = sync
        question = read_request(address, register, count)

        def accept(answer: bytes) -> bool | None:
            """As many words, or that there are no such registers."""
            return True if answer[1] == READ | _FAILED or answer[1:3] == bytes([READ, 2 * count]) else None

        self._talk = Conversation(transport, name, frames_of(address), timeout_s, (question, accept))
        self._clock = clock
        self._name = name
        self._address = address

    def read(self, register: int, count: int = 1) -> list[int]:
        """Words of holding registers, unsigned 16 bit.

        Raises
        ------
        DeviceError
            No answer that fits, or a Modbus exception.
        """
        request = read_request(self._address, register, count)

        def accept(answer: bytes) -> list[int] | None:
            self._check_exception(request, answer)
            if answer[1:3] != bytes([READ, 2 * count]):
                return None
            return [int.from_bytes(answer[3 + 2 * i : 5 + 2 * i], "big") for i in range(count)]

        try:
            return self._talk.ask(request, accept)
        except DeviceError:
            return self._talk.ask(request, accept)

    def write(self, register: int, words: list[int]) -> None:
        """Write words to consecutive registers; raises as `read` does."""
        request = write_request(self._address, register, words)

        def accept(answer: bytes) -> bool | None:
            self._check_exception(request, answer)
            return True if answer[:6] == request[:6] else None

        try:
            self._talk.ask(request, accept)
        finally:
            self._clock.sleep(_AFTER_WRITE_S)

    def _check_exception(self, request: bytes, answer: bytes) -> None:
        if answer[1] == request[1] | _FAILED:
            reason = _EXCEPTIONS.get(answer[2], "unknown")
            msg = f"{self._name}: refused {request.hex(' ')} (Modbus exception {answer[2]}: {reason})."
            raise DeviceError(msg)


class ModbusSlave:
    """The device's side over a register map; incremental, never raising on any bytes.

    Real slaves tell frames apart by silence; here a request is complete when its length and CRC fit, and bytes that
    begin no request are dropped one by one.
    """

    def __init__(self, address: int, registers: RegisterMap) -> None:
        self._address = address
        self._registers = registers
        self._buffer = b""

    def feed(self, data: bytes) -> bytes:
        """Answers to the requests completed by `data`."""
        self._buffer += data
        answers = b""
        while len(self._buffer) >= 8:
            length = 9 + self._buffer[6] if self._buffer[1] == WRITE_MANY else 8
            if self._buffer[0] != self._address or self._buffer[1] not in (READ, WRITE_ONE, WRITE_MANY):
                self._buffer = self._buffer[1:]
                continue
            if len(self._buffer) < length:
                break
            request = self._buffer[:length]
            if crc16(request[:-2]) != request[-2:]:
                self._buffer = self._buffer[1:]
                continue
            self._buffer = self._buffer[length:]
            answers += self._answer(request)
        return answers

    def _answer(self, request: bytes) -> bytes:
        function, register = request[1], int.from_bytes(request[2:4], "big")
        try:
            if function == READ:
                words = [
                    self._registers.get(register + i) for i in range(int.from_bytes(request[4:6], "big"))
                ]
                data = b"".join((word & 0xFFFF).to_bytes(2, "big") for word in words)
                return frame(request[:2] + bytes([len(data)]) + data)
            data = request[4:6] if function == WRITE_ONE else request[7:-2]
            words = [int.from_bytes(data[i : i + 2], "big") for i in range(0, len(data), 2)]
            self._registers.put(register, words)
        except KeyError:
            return frame(bytes([request[0], function | 0x80, 2]))
        except ValueError:
            return frame(bytes([request[0], function | 0x80, 3]))
        return frame(request[:6])


class RegisterMap:
    """Registers of a slave; ``KeyError`` for an unknown one, ``ValueError`` for a value that is not allowed."""

    def get(self, register: int) -> int:
        """Word of a register."""
        raise KeyError(register)

    def put(self, register: int, words: list[int]) -> None:
        """Write words from `register` on."""
        raise KeyError(register)


def signed(word: int) -> int:
    """Signed value of an unsigned 16-bit word."""
    return word - 0x10000 if word & 0x8000 else word
