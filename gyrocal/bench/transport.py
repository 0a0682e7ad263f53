"""A port to a device: serial line, socket or anything pyserial has a URL for; every wait has a deadline."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import threading
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

#: Longest wait inside one look at the port; deadlines are made of such looks, and between two of them who waits attends.
_LOOK_S = 0.02
#: Most that is read in one look.
_BLOCK = 1 << 16
#: A line that takes no byte for so long takes none: short, because nothing is attended to meanwhile.
_WRITE_S = 0.25
#: Longest wait for a port of the network to open, and for any to close.
_OPEN_S, _CLOSE_S = 10.0, 1.0

#: Called by whoever waits, at least every tenth of a second; raises to end the wait.
Attend = Callable[[], None]


def nobody_asks() -> None:
    """Attend to nothing."""


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

    def close(self) -> None:
        """Close; never raises."""
        ...


class SerialTransport:
    """A pyserial port.

    Parameters
    ----------
    tap : callable, optional
        Sees all bytes with their direction: ``tap(b"<" or b">", data)``.
    attend : callable
        Called between two looks at the port.
    """

    def __init__(
        self,
        url: str,
        baud: int,
        *,
        tap: Callable[[bytes, bytes], None] | None = None,
        attend: Attend = nobody_asks,
    ):
        self.url = url
        self._tap = tap
        self._attend = attend
        self._lock = _lock_network_port(url)
        try:
            self._port = serial.serial_for_url(
                url, baudrate=baud, timeout=_LOOK_S, write_timeout=_WRITE_S, do_not_open=True
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
        try:
            data = self._there()
            while not data and time.monotonic() < deadline_s:
                self._attend()
                data = self._port.read(1)
                data += self._there() if data else b""
        except (serial.SerialException, OSError) as error:
            raise DeviceError(
                f"{self.url}: the port is gone while reading ({error}). Check the cable."
            ) from error
        if data and self._tap is not None:
            self._tap(b"<", data)
        return data

    def _there(self) -> bytes:
        """What has come already. A socket:// port reports at most 1 waiting byte: there a block is asked for."""
        if "://" not in self.url:
            waiting = self._port.in_waiting
            return bytes(self._port.read(waiting)) if waiting else b""
        self._port.timeout = 0
        try:
            return bytes(self._port.read(_BLOCK))
        finally:
            self._port.timeout = _LOOK_S

    def close(self) -> None:
        """Close; never raises. A port that hangs in it is left to itself."""
        closing = threading.Thread(target=self._close, name=f"close {self.url}", daemon=True)
        closing.start()
        closing.join(_CLOSE_S)

    def _close(self) -> None:
        with contextlib.suppress(serial.SerialException, OSError):
            self._port.close()
        self._unlock()

    def _unlock(self) -> None:
        lock, self._lock = self._lock, None
        if lock is not None:
            os.close(lock)


def opened_within(url: str, open_port: Callable[[], Transport], attend: Attend) -> Transport:
    """Open a port, attending meanwhile: a host of the network that does not answer lets one wait.

    Raises
    ------
    DeviceError
        The port cannot be opened, or not in time. One that opens later is closed again.
    """
    if "://" not in url:
        return open_port()
    opening = _Opening(open_port)
    deadline_s = time.monotonic() + _OPEN_S
    try:
        while opening.is_alive() and time.monotonic() < deadline_s:
            opening.join(_LOOK_S)
            attend()
    except BaseException:
        opening.give_up()
        raise
    return opening.result(f"{url}: did not open within {_OPEN_S:g} s. Check the address and the network.")


class _Opening(threading.Thread):
    """A port that is being opened, and closed again where nobody waits for it any more."""

    def __init__(self, open_port: Callable[[], Transport]) -> None:
        super().__init__(name="open a port", daemon=True)
        self._open = open_port
        self._port: Transport | None = None
        self._error: Exception | None = None
        self._given_up = False
        self._guard = threading.Lock()
        self.start()

    def run(self) -> None:
        """Open."""
        try:
            port = self._open()
        except Exception as error:  # noqa: BLE001
            self._error = error
            return
        with self._guard:
            self._port = port
            if self._given_up:
                port.close()

    def give_up(self) -> None:
        """Nobody waits any more."""
        with self._guard:
            self._given_up = True
            if self._port is not None:
                self._port.close()

    def result(self, late: str) -> Transport:
        """The port, or why there is none."""
        if self.is_alive():
            self.give_up()
            raise DeviceError(late)
        if self._port is None:
            raise self._error or DeviceError(late)
        return self._port


def _lock_network_port(url: str) -> int | None:
    """Hold a port of the network for this program, as the tty lock does for others: a converter may let two in.

    Only other gyrocals on this computer know of it. None where there is nothing to lock, or no way to.
    """
    if fcntl is None or not url.startswith(("socket://", "rfc2217://")):
        return None
    name = hashlib.sha256(url.encode()).hexdigest()[:16]
    path = Path(tempfile.gettempdir()) / f"gyrocal-{name}.lock"
    try:
        lock = os.open(path, os.O_RDONLY | os.O_CREAT, 0o644)
    except OSError:
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(lock)
        msg = f"{url}: another gyrocal holds the port{_holders(path)}. Wait for it, or end it first."
        raise DeviceError(msg) from error
    return lock


def _holders(path: Path) -> str:
    """Programs that have a file open, as the kernel lists them: `` (pid 12: python -m gyrocal ...)``; empty: not known."""
    wanted = os.path.realpath(path)
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        if process.name == str(os.getpid()):
            continue
        with contextlib.suppress(OSError):  # of another user, or gone by now
            if any(os.path.realpath(fd) == wanted for fd in (process / "fd").iterdir()):
                words = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                found.append(f"pid {process.name}: {words.strip()[:80]}")
    return f" ({'; '.join(found)})" if found else ""


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
        return f"{url}: another program holds the port{_holders(Path(url))}. Close it and try again."
    if getattr(error, "errno", None) == 2 or "No such file" in text:
        return f"{url}: there is no such port. Check the cable and the name (ls /dev/serial/by-id)."
    if "Permission" in text:
        return f"{url}: may not be opened (permission denied). Add yourself to the group of serial ports (dialout)."
    if "refused" in text:
        return (
            f"{url}: nobody listens there (connection refused). Check the address and that the device is on."
        )
    if "Inappropriate ioctl" in text or "Is a directory" in text:
        return f"{url}: is no serial port. Give a device (ls /dev/serial/by-id) or a URL such as socket://host:port."
    return f"{url}: cannot be opened ({text}). Check the device and its cable, and try again."
