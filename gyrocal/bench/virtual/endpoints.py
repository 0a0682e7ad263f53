"""Where virtual devices are reached: pseudo-terminals and TCP ports, non-blocking, one client each."""

from __future__ import annotations

import contextlib
import os
import pty
import socket
import tty
from typing import Protocol


class Endpoint(Protocol):
    """A byte pipe to whoever opens `address`."""

    address: str

    def read(self) -> bytes:
        """Bytes that the client has sent; empty when there are none."""
        ...

    def write(self, data: bytes) -> None:
        """Send to the client; like a line without flow control, what nobody reads is lost."""
        ...

    def close(self) -> None:
        """Close; the client sees a port that vanishes."""
        ...


class PtyEndpoint:
    """A pseudo-terminal in raw mode; `address` is its device path."""

    def __init__(self) -> None:
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        # The slave stays open here too: else the pair hangs up when a client closes it.
        self.address = os.ttyname(self._slave)

    def read(self) -> bytes:
        """Bytes that the client has sent."""
        try:
            return os.read(self._master, 65536)
        except OSError:
            return b""

    def write(self, data: bytes) -> None:
        """Send to the client."""
        with contextlib.suppress(OSError):
            os.write(self._master, data)

    def close(self) -> None:
        """Close both ends."""
        for descriptor in (self._master, self._slave):
            with contextlib.suppress(OSError):
                os.close(descriptor)


class TcpEndpoint:
    """A listening TCP port on the loopback; `address` is its ``socket://`` URL. A new client replaces the old one."""

    def __init__(self, port: int = 0) -> None:
        self._listener = socket.create_server(("127.0.0.1", port))
        self._listener.setblocking(False)
        self._client: socket.socket | None = None
        self.address = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"

    def read(self) -> bytes:
        """Bytes that the client has sent; also lets a new client in."""
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

    def close(self) -> None:
        """Close the client and the port."""
        self._drop()
        self._listener.close()

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
