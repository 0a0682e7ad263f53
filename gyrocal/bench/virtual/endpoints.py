"""Where virtual devices are reached: pseudo-terminals and TCP ports, non-blocking, one client each."""

from __future__ import annotations

import contextlib
import os
import socket
from pathlib import Path
from typing import Protocol

from gyrocal.errors import OutputError

try:
    import pty
    import tty
except ImportError:  # Windows has no pseudo-terminals; --tcp works there
    pty = None  # type: ignore[assignment]


#: After so many writes that were refused in a row nobody reads: a server that was kept waiting itself, and sends what it
#: owes in one piece, must not lose that to a reader that is a moment late.
_PATIENCE = 100


class Endpoint(Protocol):
    """A byte pipe to whoever opens `address`."""

    address: str

    def read(self) -> bytes:
        """Bytes that the client has sent; empty when there are none."""
        ...

    def write(self, data: bytes) -> None:
        """Send to the client; like a line without flow control, what nobody reads is lost."""
        ...

    def vanish(self) -> None:
        """Be gone, as an adapter that is pulled out."""
        ...

    def come_back(self) -> None:
        """Be there again at the same address."""
        ...

    def close(self) -> None:
        """Close; the client sees a port that vanishes."""
        ...


class PtyEndpoint:
    """A pseudo-terminal in raw mode; `address` is its device path, or the symbolic `link` to it."""

    def __init__(self, link: Path | None = None) -> None:
        if pty is None:
            raise OutputError("This system has no pseudo-terminals. Use TCP ports (--tcp).")
        if link is not None and link.exists():
            raise OutputError(
                f"{link}: is there already. End the gyrocal sim that serves it, or choose other --links."
            )
        self._link = link
        self._waiting = b""
        self._refused = 0
        self._master = self._slave = -1
        self.address = ""
        self.come_back()

    def read(self) -> bytes:
        """Bytes that the client has sent."""
        try:
            return os.read(self._master, 65536)
        except OSError:
            return b""

    def write(self, data: bytes) -> None:
        """Send to the client; what the terminal has no room for goes with the next call, unless nobody reads."""
        data = self._waiting + data
        try:
            sent = os.write(self._master, data)
            self._refused = 0
        except OSError:
            sent = 0
            self._refused += 1
        self._waiting = data[sent:] if self._refused < _PATIENCE else b""

    def vanish(self) -> None:
        """Close both ends and take the link away."""
        for descriptor in (self._master, self._slave):
            with contextlib.suppress(OSError):
                os.close(descriptor)
        self._master = self._slave = -1
        self._waiting = b""
        if self._link is not None:
            self._link.unlink(missing_ok=True)

    def come_back(self) -> None:
        """Open a new pair; only a link keeps the address."""
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        # The slave stays open here too: else the pair hangs up when a client closes it.
        self.address = os.ttyname(self._slave)
        if self._link is not None:
            self._link.unlink(missing_ok=True)  # of a program that was killed
            self._link.symlink_to(self.address)
            self.address = str(self._link)

    def close(self) -> None:
        """Close both ends."""
        self.vanish()


class TcpEndpoint:
    """A listening TCP port on the loopback; `address` is its ``socket://`` URL. A new client replaces the old one."""

    def __init__(self, port: int = 0) -> None:
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None
        self._port = port
        self.come_back()
        self.address = f"socket://127.0.0.1:{self._port}"

    def read(self) -> bytes:
        """Bytes that the client has sent; also lets a new client in."""
        if self._listener is None:
            return b""
        with contextlib.suppress(OSError):
            client, _ = self._listener.accept()
            self._drop()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._client = client
        if self._client is None:
            return b""
        try:
            data = self._client.recv(65536)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop()
        return data

    def write(self, data: bytes) -> None:
        """Send to the client, when there is one."""
        if self._client is None:
            return
        try:
            self._client.sendall(data)
        except BlockingIOError:
            return
        except OSError:
            self._drop()

    def vanish(self) -> None:
        """Drop the client and refuse new ones."""
        self._drop()
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def come_back(self) -> None:
        """Listen again on the same port."""
        if self._listener is None:
            self._listener = socket.create_server(("127.0.0.1", self._port))
            self._listener.setblocking(False)
            self._port = self._listener.getsockname()[1]

    def close(self) -> None:
        """Close the client and the port."""
        self.vanish()

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
