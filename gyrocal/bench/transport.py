"""A port to a device: serial line, socket or anything pyserial has a URL for; every read and write has a deadline."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

import serial

from gyrocal.errors import DeviceError

try:
    import fcntl
except ImportError:  # a system without POSIX locks
    fcntl = None  # type: ignore[assignment]

#: Longest wait inside one look at the port; deadlines are made of such looks.
_LOOK_S = 0.02
#: No device here says more at once.
_LONGEST_ANSWER = 8192
#: Most that is read from a socket in one look.
_BLOCK = 1 << 16


class Transport(Protocol):
    """What a driver needs of a port."""

    def now_s(self) -> float:
        """Monotonic time in which this port's deadlines run, s."""
        ...

    def write(self, data: bytes) -> None:
        """Send all of `data`, or raise DeviceError."""
        ...

    def read_available(self, wait_s: float) -> bytes:
        """Bytes that have come, after waiting at most `wait_s` for the first of them; empty when none came."""
        ...

    def clear_input(self) -> None:
        """Forget what came before."""
        ...

    def close(self) -> None:
        """Close; never raises."""
        ...


class SerialTransport:
    """A pyserial port. `tap`, when given, sees all bytes with their direction: ``tap(b"<" or b">", data)``."""

    def __init__(
        self, url: str, baud: int, *, rtscts: bool = False, tap: Callable[[bytes, bytes], None] | None = None
    ):
        self.url = url
        self._tap = tap
        self._lock = _lock_network_port(url)
        try:
            self._port = serial.serial_for_url(
                url, baudrate=baud, timeout=_LOOK_S, write_timeout=1.0, rtscts=rtscts, do_not_open=True
            )
            if "://" not in url:
                # A log viewer left open on the port steals bytes; only tty devices know the lock.
                self._port.exclusive = True
            self._port.open()
        except (serial.SerialException, OSError, ValueError) as error:
            self._unlock()
            raise DeviceError(_open_failed(url, error)) from error

    def now_s(self) -> float:
        """Host monotonic time: a step of the wall clock changes no deadline."""
        return time.monotonic()

    def write(self, data: bytes) -> None:
        """Send all of `data`, or raise DeviceError."""
        try:
            self._port.write(data)
        except serial.SerialTimeoutException as error:
            msg = f"{self.url}: the device takes no bytes (write time-out). Check the cable and the flow control."
            raise DeviceError(msg) from error
        except (serial.SerialException, OSError) as error:
            raise DeviceError(
                f"{self.url}: the port is gone while writing ({error}). Check the cable."
            ) from error
        if self._tap is not None:
            self._tap(b">", data)

    def read_available(self, wait_s: float) -> bytes:
        """Bytes that have come, after waiting at most `wait_s` for the first of them."""
        deadline_s = time.monotonic() + wait_s
        while True:
            try:
                data: bytes = self._port.read(1)
                # A socket:// port reports at most 1 waiting byte, so ask for a block there and take what comes.
                waiting = self._port.in_waiting if "://" not in self.url else _BLOCK
                if data and waiting:
                    data += self._port.read(waiting) if "://" not in self.url else self._rest()
            except (serial.SerialException, OSError) as error:
                raise DeviceError(
                    f"{self.url}: the port is gone while reading ({error}). Check the cable."
                ) from error
            if data:
                if self._tap is not None:
                    self._tap(b"<", data)
                return data
            if time.monotonic() >= deadline_s:
                return b""

    def _rest(self) -> bytes:
        self._port.timeout = 0
        try:
            rest: bytes = self._port.read(_BLOCK)
        finally:
            self._port.timeout = _LOOK_S
        return rest

    def clear_input(self) -> None:
        """Forget what came before."""
        with contextlib.suppress(DeviceError):
            while self.read_available(0.0):
                pass

    def close(self) -> None:
        """Close; never raises."""
        with contextlib.suppress(serial.SerialException, OSError):
            self._port.close()
        self._unlock()

    def _unlock(self) -> None:
        lock, self._lock = self._lock, None
        if lock is not None:
            os.close(lock)


def _lock_network_port(url: str) -> int | None:
    """Hold a port of the network for this program, as the tty lock does for others: a converter may let two in.

    Only other gyrocals on this computer know of it. None where there is nothing to lock, or no way to.
    """
    if fcntl is None or not url.startswith(("socket://", "rfc2217://")):
        return None
    name = hashlib.sha256(url.encode()).hexdigest()[:16]
    try:
        lock = os.open(Path(tempfile.gettempdir()) / f"gyrocal-{name}.lock", os.O_RDONLY | os.O_CREAT, 0o644)
    except OSError:
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(lock)
        raise DeviceError(f"{url}: another gyrocal holds the port. Wait for it, or end it first.") from error
    return lock


class ReopeningTransport:
    """A port that is opened at its first use, and again after it was gone: each use makes one attempt."""

    def __init__(self, open_port: Callable[[], Transport]) -> None:
        self._open = open_port
        self._port: Transport | None = None

    def now_s(self) -> float:
        """Host monotonic time, or the open port's own."""
        return time.monotonic() if self._port is None else self._port.now_s()

    def write(self, data: bytes) -> None:
        """Send all of `data`, or raise DeviceError."""
        with self._lost_on_error() as port:
            port.write(data)

    def read_available(self, wait_s: float) -> bytes:
        """Bytes that have come, after waiting at most `wait_s` for the first of them."""
        with self._lost_on_error() as port:
            return port.read_available(wait_s)

    def clear_input(self) -> None:
        """Forget what came before; a port that is gone has nothing to forget."""
        if self._port is not None:
            self._port.clear_input()

    def close(self) -> None:
        """Close; never raises. The next use opens it again."""
        port, self._port = self._port, None
        if port is not None:
            port.close()

    @contextlib.contextmanager
    def _lost_on_error(self) -> Iterator[Transport]:
        if self._port is None:
            self._port = self._open()
        try:
            yield self._port
        except DeviceError:
            self.close()
            raise


def _open_failed(url: str, error: Exception) -> str:
    text = str(error)
    if isinstance(error, ValueError):
        return f"{url}: is no port that can be opened ({text}). Give a device path or a URL such as socket://host:port."
    if "exclusively lock" in text or "busy" in text.lower():
        return f"{url}: another program holds the port. Close it and try again."
    if getattr(error, "errno", None) == 2 or "No such file" in text:
        return f"{url}: there is no such port. Check the cable and the name (ls /dev/serial/by-id)."
    if "Permission" in text:
        return f"{url}: may not be opened (permission denied). Add yourself to the group of serial ports (dialout)."
    if "refused" in text:
        return (
            f"{url}: nobody listens there (connection refused). Check the address and that the device is on."
        )
    return f"{url}: cannot be opened ({text})."


class Conversation:
    """Request and answer over a transport, matched by a terminator, with a deadline on each."""

    def __init__(self, transport: Transport, name: str, terminator: bytes, timeout_s: float) -> None:
        self.transport = transport
        self._name = name
        self._terminator = terminator
        self._timeout_s = timeout_s
        self._buffer = b""

    def number(self, text: str, command: str) -> float:
        """The number that `text` is, the answer to `command`; DeviceError where it is none."""
        try:
            return float(text)
        except ValueError as error:
            msg = f"{self._name}: answered {text!r} to {command!r}, and a number is wanted."
            raise DeviceError(msg) from error

    def send(self, data: bytes) -> None:
        """Send without waiting for an answer."""
        self.transport.write(data)

    def clear(self) -> None:
        """Forget every byte that came before."""
        self._buffer = b""
        self.transport.clear_input()

    def ask(self, request: bytes) -> bytes:
        """Send `request` and return the answer without its terminator; old bytes are forgotten first."""
        self.clear()
        self.transport.write(request)
        return self.receive(request)

    def receive(self, request: bytes = b"") -> bytes:
        """The next answer, without its terminator."""
        deadline_s = self.transport.now_s() + self._timeout_s
        while self._terminator not in self._buffer:
            left_s = deadline_s - self.transport.now_s()
            if left_s <= 0:
                said = f"half an answer ({self._buffer[:40]!r})" if self._buffer else "no answer"
                msg = f"{self._name}: {said} to {request!r} within {self._timeout_s:g} s. Check power, cable, baud rate and address."
                raise DeviceError(msg)
            self._buffer += self.transport.read_available(min(left_s, 0.1))
            if len(self._buffer) > _LONGEST_ANSWER:
                msg = f"{self._name}: {len(self._buffer)} bytes came and no end of an answer to {request!r}. Check the baud rate."
                raise DeviceError(msg)
        answer, self._buffer = self._buffer.split(self._terminator, 1)
        return answer

    def receive_exactly(self, count: int, request: bytes) -> bytes:
        """The next `count` bytes of a binary answer."""
        deadline_s = self.transport.now_s() + self._timeout_s
        while len(self._buffer) < count:
            left_s = deadline_s - self.transport.now_s()
            if left_s <= 0:
                said = f"{len(self._buffer)} of {count} bytes" if self._buffer else "no answer"
                msg = f"{self._name}: {said} to {request.hex(' ')} within {self._timeout_s:g} s. Check power, cable, baud rate and address."
                raise DeviceError(msg)
            self._buffer += self.transport.read_available(min(left_s, 0.1))
        answer, self._buffer = self._buffer[:count], self._buffer[count:]
        return answer
