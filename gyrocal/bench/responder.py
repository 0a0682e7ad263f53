"""The device's side of a line protocol: bytes in, answers out, a table or chamber behind it."""

from __future__ import annotations

from abc import ABC, abstractmethod


class LineResponder(ABC):
    """Collects bytes into lines and answers each; incremental, never raising on any bytes."""

    terminator = b"\r"
    max_line = 512

    def __init__(self) -> None:
        self._buffer = b""

    @abstractmethod
    def answer(self, line: str) -> bytes:
        """Bytes that the device sends for one command line; empty when it keeps silent."""

    def feed(self, data: bytes) -> bytes:
        """Answers to the lines completed by `data`."""
        self._buffer += data
        answers = b""
        while self.terminator in self._buffer:
            line, self._buffer = self._buffer.split(self.terminator, 1)
            text = line.strip(b"\r\n\0 ").decode("ascii", errors="replace")
            if text:
                answers += self.answer(text)
        self._buffer = self._buffer[-self.max_line :]
        return answers
