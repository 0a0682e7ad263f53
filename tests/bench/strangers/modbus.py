"""Watlow chambers whose registers are served by pymodbus: another library's frames, exceptions and timing."""

from __future__ import annotations

import asyncio
import struct
import threading
from typing import Any

from pymodbus.constants import ExcCodes
from pymodbus.framer import FramerType
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from tests.bench.strangers.chambers import HIGHEST_C, LOWEST_C, ChamberDevice
from tests.bench.strangers.lab import Lab

_WRITES = (5, 6, 15, 16)


class ModbusChamber(ChamberDevice):
    """A chamber whose registers are asked for and written by RTU frames over TCP, as a serial device server has them."""

    #: Registers that there are, in blocks of (first, count).
    blocks: tuple[tuple[int, int], ...] = ()

    def open(self, tcp: bool) -> None:
        self._started = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()), daemon=True)
        self._thread.start()
        if not self._started.wait(10.0):
            raise TimeoutError("the Modbus server does not start")

    def close(self) -> None:
        """End the server."""
        self._loop.call_soon_threadsafe(self._ending.set)
        self._thread.join()

    def registers(self) -> dict[int, int]:
        """What the registers hold now."""
        raise NotImplementedError

    def write(self, address: int, values: list[int]) -> bool:
        """Take what was written; False refuses it."""
        raise NotImplementedError

    async def _run(self) -> None:
        self._loop, self._ending = asyncio.get_running_loop(), asyncio.Event()
        data = [SimData(a, count=n, values=0, datatype=DataType.REGISTERS) for a, n in self.blocks]
        device = SimDevice(1, simdata=data, action=self._act)
        self._server = ModbusTcpServer(device, framer=FramerType.RTU, address=("127.0.0.1", 0))
        await self._server.listen()
        port = self._server.transport.sockets[0].getsockname()[1]  # type: ignore[attr-defined]
        self.url = f"socket://127.0.0.1:{port}"
        self._started.set()
        await self._ending.wait()
        await self._server.shutdown()  # type: ignore[no-untyped-call]

    async def _act(
        self, function: int, start: int, address: int, count: int, current: list[int], new: Any
    ) -> ExcCodes | None:
        if function in _WRITES and new is not None:
            return None if self.write(address, [int(v) for v in new]) else ExcCodes.ILLEGAL_VALUE
        for register, value in self.registers().items():
            if start <= register < start + len(current):
                current[register - start] = value
        return None


class F4(ModbusChamber):
    """Watlow F4S with one decimal; a profile may be terminated, register 200 says static or running."""

    kind = "watlow-f4"
    blocks = (
        (0, 210),
        (300, 20),
        (600, 10),
        (901, 1),
        (1056, 20),
        (1200, 20),
        (1300, 20),
        (2000, 80),
        (4122, 2),
    )

    def __init__(self, lab: Lab, *, tcp: bool = True) -> None:
        self.profile_state = 2
        self.error = 0
        super().__init__(lab, tcp=tcp)
        self.world.running = True

    def registers(self) -> dict[int, int]:
        world = self.world
        tenths = {
            100: world.air_c,
            300: world.setpoint_c,
            602: LOWEST_C,
            603: HIGHEST_C,
            4122: world.setpoint_c,
        }
        return {
            **{register: round(10.0 * value) & 0xFFFF for register, value in tenths.items()},
            101: self.error,
            102: self.alarm,
            200: self.profile_state,
            606: 1,
            901: 1,
        }

    def write(self, address: int, values: list[int]) -> bool:
        if address == 300:
            tenths = values[0] - 0x10000 if values[0] & 0x8000 else values[0]
            return self.set_point(0.1 * tenths, f"300 = {tenths}")
        if address == 1217:
            self.profile_state = 0
        return True


class F4tModbus(ModbusChamber):
    """Watlow F4T: floats of two registers, the low word first."""

    kind = "watlow-f4t-modbus"
    blocks = ((1300, 120), (2700, 240), (6700, 400), (16560, 20))
    lsb_c = 0.01

    def __init__(self, lab: Lab, *, tcp: bool = True) -> None:
        self.mode = 62
        super().__init__(lab, tcp=tcp)

    def registers(self) -> dict[int, int]:
        world = self.world
        floats = {
            2820: world.air_c,
            2782: world.setpoint_c,
            2810: world.setpoint_c,
            2774: LOWEST_C,
            2776: HIGHEST_C,
        }
        result = {2730: self.mode, 2814: self.mode, 16568: 149, **{1356 + 100 * i: 61 for i in range(1)}}
        for register, value in floats.items():
            high, low = struct.unpack(">HH", struct.pack(">f", value))
            result |= {register: low, register + 1: high}
        return result

    def write(self, address: int, values: list[int]) -> bool:
        if address == 2782 and len(values) == 2:
            (temp_c,) = struct.unpack(">f", struct.pack(">HH", values[1], values[0]))
            return self.set_point(temp_c, f"2782 = {temp_c:g}")
        if address == 2730:
            self.mode = values[0]
            self.world.running = self.mode == 10
        return True


MODBUS_CHAMBERS: dict[str, type[ModbusChamber]] = {c.kind: c for c in (F4, F4tModbus)}
