"""Lines that talk by themselves, answer late or not to the question; tables that do not obey; ports that others hold."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrocal.bench.clock import VirtualClock
from gyrocal.bench.conversation import Conversation, ended_by
from gyrocal.bench.profile import profile_from_dict
from gyrocal.bench.safety import StopRequests
from gyrocal.bench.session import AcquireConfig, acquire
from gyrocal.bench.transport import SerialTransport
from gyrocal.bench.virtual.endpoints import PtyEndpoint, TcpEndpoint
from gyrocal.errors import DeviceError, InterruptedRunError, StopNotVerifiedError, exit_code
from tests.bench.onwire.faulty import Span
from tests.bench.onwire.stand import WireStand
from tests.bench.onwire.test_sim import SHORT, profile_file, serving, wired
from tests.bench.pulse import Pulse
from tests.bench.test_runner import events
from tests.bench.tiny import Silent, tiny
from tests.bench.wire import LoopTransport

TABLES = ("aerosmith", "zaber", "acutrol", "json-lines")
every_table = pytest.mark.parametrize("table", TABLES)


@dataclass
class TardyLine:
    """Delivers each message after a delay of its own, and in order: a controller that is busy answers in turn."""

    delay_s: Callable[[], float]
    span: Span = field(default_factory=Span)
    _waiting: list[tuple[float, bytes]] = field(default_factory=list)

    def carry(self, now_s: float, messages: Sequence[bytes], request: bytes) -> bytes:
        """What is due."""
        for message in messages:
            due_s = now_s + (self.delay_s() if self.span.holds(now_s) else 0.0)
            last_s = self._waiting[-1][0] if self._waiting else 0.0
            self._waiting.append((max(due_s, last_s), message))
        due = b"".join(message for due_s, message in self._waiting if due_s <= now_s)
        self._waiting = [(due_s, message) for due_s, message in self._waiting if due_s > now_s]
        return due


def uniform(seed: int, low_s: float, high_s: float) -> Callable[[], float]:
    rng = np.random.default_rng(seed)
    return lambda: float(rng.uniform(low_s, high_s))


def at_once(number: int, delay_s: float) -> Callable[[], float]:
    """The answer of this number comes late, no other does."""
    left = [number]

    def delay() -> float:
        left[0] -= 1
        return delay_s if left[0] == 0 else 0.0

    return delay


def stubborn() -> Callable[[float, float], float]:
    """A table that takes every rate but 0."""
    last = [0.0]

    def command(now_s: float, rate_dps: float) -> float:
        last[0] = rate_dps or last[0]
        return last[0]

    return command


def options_of(table: str) -> dict[str, Any]:
    """What lets a kind of table be quick enough in this small world."""
    return {"settle__tolerance_dps": 0.05} if table != "json-lines" else {}


@every_table
@pytest.mark.parametrize("seed", [1, *(pytest.param(s, marks=pytest.mark.slow) for s in range(2, 6))])
def test_a_table_that_ignores_the_stop_and_answers_late_is_never_said_to_stand(
    tmp_path: Path, table: str, seed: int
) -> None:
    tardy = TardyLine(uniform(seed, 0.6, 0.9))

    def at(stand: WireStand, now_s: float) -> None:
        if now_s > 34.0 and abs(stand.world.read_table()[0]) > 20.0:
            stand.line("table", tardy)
            stand.requests.ask(2, "SIGTERM")

    stand = WireStand(
        tmp_path / "r", table=table, at=at, faulty_table={"command": stubborn()}, **options_of(table)
    )
    with pytest.raises(StopNotVerifiedError, match="MAY STILL BE TURNING"):
        stand.run()
    assert abs(stand.world.read_table()[0]) > 20.0
    assert [line["table_stopped"] for line in events(stand.out, "make_safe")] == [False]


@every_table
def test_a_table_that_obeys_and_answers_late_is_seen_to_stand(tmp_path: Path, table: str) -> None:
    stand = WireStand(tmp_path / "r", table=table, **options_of(table)).line(
        "table", TardyLine(uniform(4, 0.6, 0.9), Span(36.0))
    )
    stand._at = lambda s, now_s: s.requests.ask(2, "SIGTERM") if now_s > 36.0 else None
    with pytest.raises(InterruptedRunError):
        stand.run()
    assert [line["table_stopped"] for line in events(stand.out, "make_safe")] == [True]
    assert stand.world.read_table()[0] == 0.0


@every_table
@pytest.mark.parametrize(
    ("number", "delay_s"),
    [
        pytest.param(n, d, marks=[] if (n, d) == (2, 2.6) else [pytest.mark.slow])
        for n in (1, 2, 3, 4)
        for d in (0.7, 1.3, 2.6)
    ],
)
def test_one_late_answer_ends_no_run_and_passes_for_no_other(
    tmp_path: Path, table: str, number: int, delay_s: float
) -> None:
    late = TardyLine(at_once(number, delay_s), Span(32.0))
    stand = WireStand(tmp_path / "r", table=table, **options_of(table)).line("table", late)
    summary = stand.run()
    assert summary.complete, (summary, stand.watch.said)
    for rate_dps in readings(stand):
        assert abs(rate_dps) < 32.0, "an angle has passed for a rate"


def readings(stand: WireStand) -> list[float]:
    """Every rate of the table that was recorded, deg/s."""
    found = []
    for path in (stand.out / "data").glob("*.csv"):
        head, *rows = path.read_text().splitlines()
        column = head.split(",").index("table_rate_dps")
        found += [float(cell) for row in rows if (cell := row.split(",")[column])]
    assert found
    return found


# lines that talk by themselves


class Babbling(LoopTransport):
    """Two bytes every 5 ms, whatever is asked, on a clock of its own."""

    def __init__(self) -> None:
        super().__init__(self)
        self.clock = VirtualClock()

    def feed(self, data: bytes) -> bytes:
        return b""

    def now_s(self) -> float:
        return self.clock.now_s()

    def read_available(self, wait_s: float) -> bytes:
        self.clock.sleep(min(wait_s, 0.005))
        return b"U."


def test_a_line_that_talks_by_itself_is_named_and_nothing_is_sent() -> None:
    port = Babbling()
    talk = Conversation(port, "ESPEC chamber", ended_by(b"\r\n"), 3.0)
    with pytest.raises(DeviceError, match=r"talks by itself \(\d+ bytes that nobody asked for\): a gyro\?"):
        talk.ask(b"TEMP?\r\n", lambda answer: answer)
    assert port.clock.now_s() < 0.5
    assert port.sent == []


def babble(endpoint: PtyEndpoint | TcpEndpoint, stop: threading.Event) -> None:
    while not stop.wait(0.005):
        endpoint.write(b"\x07U")


@pytest.mark.parametrize("tcp", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_port_that_babbles_is_read_in_a_moment(tmp_path: Path, tcp: bool) -> None:
    endpoint: PtyEndpoint | TcpEndpoint = TcpEndpoint() if tcp else PtyEndpoint(tmp_path / "port")
    port = SerialTransport(endpoint.address, 9600)
    endpoint.read()
    stop = threading.Event()
    thread = threading.Thread(target=babble, args=(endpoint, stop), daemon=True)
    thread.start()
    talk = Conversation(port, "ESPEC chamber", ended_by(b"\r\n"), 3.0)
    began_s = time.monotonic()
    with Pulse() as pulse:
        for _ in range(2):  # the second time it talks before it is asked
            with pytest.raises(DeviceError, match="talks by itself"):
                talk.ask(b"TEMP?\r\n", lambda answer: answer)
    assert pulse.given_s(began_s, time.monotonic()) < 5.0
    stop.set()
    thread.join()
    port.close()
    endpoint.close()


@dataclass
class BabblingLine:
    """A line that carries what it should, and two bytes of its own every 5 ms."""

    span: Span
    _said_s: float = 0.0

    def carry(self, now_s: float, messages: Sequence[bytes], request: bytes) -> bytes:
        """The messages, and noise since the last call."""
        count = int((now_s - self._said_s) / 0.005) if self.span.holds(now_s) else 0
        self._said_s = now_s if count or not self.span.holds(now_s) else self._said_s
        return b"\x07U" * min(count, 20) + b"".join(messages)


def stop_times(served: Any, wanted: bytes) -> list[float]:
    """When the served table is told to stop, by the host's clock; filled while it runs."""
    times: list[float] = []
    responder = served.server.table.responder
    feed = responder.feed

    def listening(data: bytes) -> bytes:
        if wanted in data:
            times.append(time.monotonic())
        answers: bytes = feed(data)
        return answers

    responder.feed = listening
    return times


@pytest.mark.parametrize("line", ["babbles", pytest.param("is silent", marks=pytest.mark.slow)])
def test_a_signal_is_served_at_once_whatever_a_line_does(tmp_path: Path, line: str) -> None:
    changes = {**SHORT, "plan__rates_dps": [60.0], "plan__dwell_s": 30.0, "plan__zero_first_and_last": False}
    profile = profile_from_dict(tiny(**changes), "hostile.toml")
    requests = StopRequests()
    kinds: dict[str, str | None] = {"gyro": "kvh-dsp3000", "table": "zaber", "chamber": "espec"}
    asked: list[float] = []
    with Pulse() as pulse, serving(profile, kinds, tmp_path) as served:
        stops = stop_times(served, b" stop:")

        def spoil() -> None:
            while abs(served.server._world.read_table()[0]) < 55.0:
                time.sleep(0.05)
            now_s = served.server._clock.now_s()
            chamber = BabblingLine(Span(0.0), now_s) if line == "babbles" else TardyLine(lambda: 1e9)
            served.server.chamber.line = chamber
            time.sleep(1.3)
            asked.append(time.monotonic())
            requests.ask(2, "SIGTERM")

        path = profile_file(wired(profile, served), tmp_path / "wired.toml")
        threading.Thread(target=spoil, daemon=True).start()
        with pytest.raises((InterruptedRunError, DeviceError)):
            acquire(AcquireConfig(path, tmp_path / "r"), Silent(), requests)
        first = next(t for t in stops if t > asked[0] - 1.0)
        assert pulse.given_s(asked[0], first) < 0.5
        assert abs(served.server._world.read_table()[0]) < 1e-6
    (made_safe,) = events(tmp_path / "r", "make_safe")
    assert made_safe["table_stopped"] is True


def test_ports_of_gyro_and_table_exchanged_end_with_a_sentence(tmp_path: Path) -> None:
    profile = profile_from_dict(tiny(**{**SHORT, "sensor__sample_rate_hz": 100.0}), "swapped.toml")
    kinds: dict[str, str | None] = {"gyro": "kvh-frame-a", "table": "zaber", "chamber": "espec"}
    with serving(profile, kinds, tmp_path) as served:
        raw = json.loads(json.dumps(dict(wired(profile, served).raw)))
        gyro, table = raw["gyro"], raw["table"]
        gyro["device"], table["device"] = (
            f"{kind}:{other.partition(':')[2]}"
            for kind, other in (("kvh-frame-a", table["device"]), ("zaber", gyro["device"]))
        )
        path = profile_file(profile_from_dict(raw, "swapped.toml"), tmp_path / "swapped-ports.toml")
        began_s = time.monotonic()
        with pytest.raises(
            DeviceError, match=r"Zaber table: this port talks by itself .*: a gyro\?"
        ) as caught:
            acquire(AcquireConfig(path, tmp_path / "r"), Silent())
        assert exit_code(caught.value) == 9
        assert time.monotonic() - began_s < 30.0


# ports that are missing, or held by another program


def test_a_table_that_is_missing_is_no_emergency(tmp_path: Path) -> None:
    stand = WireStand(tmp_path / "r", table="zaber")
    stand.ports["table"].vanish()
    with pytest.raises(DeviceError, match="there is no such port") as caught:
        stand.run()
    assert exit_code(caught.value) == 9
    (line,) = events(stand.out, "make_safe")
    assert (line["table_moved"], line["table_stopped"], line["chamber_setpoint_c"]) == (False, False, None)
    assert stand.ports["chamber"].sent == b"", "the chamber may be another's"
    assert stand.clock.now_s() < 30.0


def test_a_table_that_nobody_moved_and_that_turns_is_one(tmp_path: Path) -> None:
    stand = WireStand(tmp_path / "r", table="zaber", faulty_table={"command": stubborn()})
    stand.table.set_rate(40.0)  # by a program that was killed
    stand.line("gyro", TardyLine(lambda: 1e9))
    with pytest.raises(StopNotVerifiedError, match="its last read-back was 40"):
        stand.run()


@pytest.mark.parametrize("tcp", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_port_that_another_gyrocal_holds_says_who(tmp_path: Path, tcp: bool) -> None:
    profile = profile_from_dict(tiny(**SHORT), "held.toml")
    kinds: dict[str, str | None] = {"gyro": "kvh-dsp3000", "table": "zaber", "chamber": "espec"}
    with serving(profile, kinds, None if tcp else tmp_path) as served:
        holder = (
            "import sys, time; from gyrocal.bench.transport import SerialTransport; "
            f"p = SerialTransport({served.addresses['table']!r}, 115200); print('held', flush=True); time.sleep(300)"
        )
        with subprocess.Popen([sys.executable, "-c", holder], stdout=subprocess.PIPE) as process:
            try:
                assert process.stdout is not None
                assert process.stdout.readline() == b"held\n"
                path = profile_file(wired(profile, served), tmp_path / "wired.toml")
                command = [
                    sys.executable,
                    "-m",
                    "gyrocal",
                    "acquire",
                    str(path),
                    "--out",
                    str(tmp_path / "r"),
                ]
                done = subprocess.run(command, capture_output=True, text=True, timeout=120)
            finally:
                process.kill()
    assert done.returncode == 9, done.stderr
    assert f"pid {process.pid}: {sys.executable} -c" in done.stderr
    assert "MAY STILL BE TURNING" not in done.stderr
