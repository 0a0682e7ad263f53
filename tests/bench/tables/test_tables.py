"""Table drivers against scripted conversations and against the same wire seen from the device."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrocal.bench.clock import VirtualClock
from gyrocal.bench.devices import RateTable, TableReading
from gyrocal.bench.tables import acutrol, aerosmith, json_lines, manual, zaber
from gyrocal.bench.transport import Transport
from gyrocal.errors import DeviceError, InterruptedRunError
from tests.bench.wire import IdealTable, LoopTransport, Responder, ScriptedTransport

CLOCK = VirtualClock()

MakeDriver = Callable[[Transport], RateTable]
MakeResponder = Callable[[RateTable], Responder]

TABLES: dict[str, tuple[MakeDriver, MakeResponder]] = {
    "aerosmith": (
        lambda t: aerosmith.AerosmithTable(t, CLOCK, aerosmith.Options(decimals=3, timeout_s=0.004)),
        aerosmith.AerosmithResponder,
    ),
    "zaber": (lambda t: zaber.ZaberTable(t, CLOCK, zaber.Options(timeout_s=0.004)), zaber.ZaberResponder),
    "acutrol": (
        lambda t: acutrol.AcutrolTable(t, CLOCK, acutrol.Options(timeout_s=0.004)),
        acutrol.AcutrolResponder,
    ),
    "json_lines": (
        lambda t: json_lines.JsonLinesTable(t, CLOCK, json_lines.Options(timeout_s=0.004)),
        json_lines.JsonLinesResponder,
    ),
}
tables = pytest.mark.parametrize("name", TABLES)


@tables
@pytest.mark.parametrize("rate_dps", [-99.5, -3.0, 0.0, 12.5, 100.0])
def test_rate_goes_through_the_wire_and_comes_back(name: str, rate_dps: float) -> None:
    table = IdealTable()
    driver = TABLES[name][0](LoopTransport(TABLES[name][1](table)))
    driver.start()
    made_dps = driver.set_rate(rate_dps)
    assert made_dps == pytest.approx(rate_dps, abs=1e-3)
    assert table.rate_dps == pytest.approx(made_dps, abs=1e-9)
    reading = driver.read()
    assert reading.rate_dps == pytest.approx(rate_dps, abs=1e-3)
    assert reading.angle_deg == pytest.approx(12.5, abs=1e-3)
    assert driver.faults() == ()


@tables
def test_stop_is_complete_and_needs_no_answer(name: str) -> None:
    table = IdealTable()
    transport = LoopTransport(TABLES[name][1](table))
    driver = TABLES[name][0](transport)
    driver.start()
    driver.set_rate(50.0)
    driver.send_stop()
    assert table.rate_dps == 0.0
    assert transport.sent[-1][-1:] in (b"\r", b"\n")
    assert driver.read().rate_dps == 0.0


@tables
def test_a_rate_beyond_the_limit_is_refused_before_anything_is_sent(name: str) -> None:
    transport = LoopTransport(TABLES[name][1](IdealTable()))
    driver = TABLES[name][0](transport)
    driver.start()
    before = len(transport.sent)
    with pytest.raises(DeviceError, match="nothing was sent"):
        driver.set_rate(1e6)
    assert len(transport.sent) == before


@tables
def test_silence_is_named(name: str) -> None:
    class Deaf:
        def feed(self, data: bytes) -> bytes:
            return b""

    with pytest.raises(DeviceError, match=r"no answer to .* Check power, cable, baud rate and address"):
        TABLES[name][0](LoopTransport(Deaf())).read()


@tables
@given(data=st.binary(max_size=200))
def test_a_garbled_answer_is_a_device_error_or_a_number(name: str, data: bytes) -> None:
    class Garbling:
        def feed(self, _: bytes) -> bytes:
            return data

    with contextlib.suppress(DeviceError):
        reading = TABLES[name][0](LoopTransport(Garbling())).read()
        assert isinstance(reading.rate_dps, float)


@tables
@given(data=st.binary(max_size=200))
def test_a_responder_survives_any_bytes(name: str, data: bytes) -> None:
    responder = TABLES[name][1](IdealTable())
    responder.feed(data)
    responder.feed(b"\r\n")
    TABLES[name][0](LoopTransport(responder)).start()


def test_aerosmith_conversation_with_an_owed_answer() -> None:
    port = ScriptedTransport(
        (b"PVE\r", b"0.000\r\n>"),
        (b"ACL100\r", b"\r\n>"),
        (b"JOG-30\r", b""),
        (b"PVE\r", b"\r\n>PVE -29.998\r\n>"),
        (b"PPO\r", b"-12.345\r\n>"),
        (b"STO\r", b""),
    )
    driver = aerosmith.AerosmithTable(port, CLOCK, aerosmith.Options(timeout_s=0.004))
    driver.start()
    assert driver.set_rate(30.0) == 30.0
    reading = driver.read()
    assert (reading.rate_dps, reading.angle_deg) == (29.998, 12.345)
    driver.send_stop()
    port.finish()
    driver.close()
    assert port.closed


def test_aerosmith_names_what_it_did_not_understand() -> None:
    port = ScriptedTransport((b"PVE\r", b"?\r\n>"))
    with pytest.raises(DeviceError, match="did not understand 'PVE'"):
        aerosmith.AerosmithTable(port, CLOCK, aerosmith.Options(timeout_s=0.004)).start()


@pytest.mark.parametrize(
    ("text", "check"), [("1 0 move vel 10000", "30"), ("1 get pos", "FD"), ("01 0 OK IDLE -- 0", "8D")]
)
def test_zaber_checksum_vectors(text: str, check: str) -> None:
    assert zaber.lrc(text) == check


def test_zaber_conversation() -> None:
    def message(body: str) -> bytes:
        return f"/{body}:{zaber.lrc(body)}\r\n".encode()

    def reply(body: str) -> bytes:
        return f"@{body}:{zaber.lrc(body)}\r\n".encode()

    port = ScriptedTransport(
        (message("1 1 move vel 17476"), b"#01 1 note\r\n" + reply("01 1 OK BUSY -- 0")),
        (message("1 1"), b"@01 1 OK BUSY WS 0\r\n"),
        (message("1 1 stop"), b""),
    )
    driver = zaber.ZaberTable(port, CLOCK, zaber.Options(timeout_s=0.004))
    assert driver.set_rate(10.0) == pytest.approx(9.99985, abs=1e-5)
    assert driver.faults() == ("Zaber warning flag WS",)
    driver.send_stop()
    port.finish()


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (b"@01 1 RJ IDLE -- BADDATA\r\n", r"rejected .* \(BADDATA\)"),
        (b"@02 1 OK IDLE -- 0\r\n", "device 02 answered"),
        (b"@01 1 OK IDLE -- 0:00\r\n", "damaged answer"),
        (b"@01 1 OK IDLE -- x\r\n", "a number is wanted"),
    ],
)
def test_zaber_refuses(answer: bytes, text: str) -> None:
    port = ScriptedTransport((b"/1 1 get vel:" + zaber.lrc("1 1 get vel").encode() + b"\r\n", answer))
    with pytest.raises(DeviceError, match=text):
        zaber.ZaberTable(port, CLOCK, zaber.Options(timeout_s=0.004)).read()


def test_acutrol_conversation_and_latched_fault() -> None:
    port = ScriptedTransport(
        (b":Utility:Lockout ON\r\n", b"00000002OK\r\n"),
        (b":Limit:Vtrip R,1,440.000\r\n", b"00000002OK\r\n"),
        (b":Interlock? 1\r\n", b"00000005Fault\r\n"),
    )
    with pytest.raises(DeviceError, match="interlock Fault is latched"):
        acutrol.AcutrolTable(port, CLOCK, acutrol.Options(timeout_s=0.004)).start()
    port.finish()


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (b"0113000bnot recognised\r\n", "error 113 to"),
        (b"OK\r\n", r"Check prefix_characters and code_characters in \[table.options\]"),
        (b"00000002OK\r\n", "a number is wanted"),
    ],
)
def test_acutrol_refuses(answer: bytes, text: str) -> None:
    port = ScriptedTransport((b":Read:Rate? 1\r\n", answer))
    with pytest.raises(DeviceError, match=text):
        acutrol.AcutrolTable(port, CLOCK, acutrol.Options(timeout_s=0.004)).read()


def test_acutrol_split_of_the_prefix_is_an_option() -> None:
    options = acutrol.Options(prefix_characters=5, code_characters=2, timeout_s=0.004)
    port = ScriptedTransport(
        (b":Read:Rate? 1\r\n", b"000039.5\r\n"), (b":Read:Position? 1\r\n", b"000011\r\n")
    )
    assert acutrol.AcutrolTable(port, CLOCK, options).read().rate_dps == 9.5
    port.finish()


def test_aerosmith_refuses_a_rate_that_its_decimals_make_nothing() -> None:
    port = ScriptedTransport()
    driver = aerosmith.AerosmithTable(port, CLOCK, aerosmith.Options(decimals=0, timeout_s=0.004))
    with pytest.raises(DeviceError, match=r"0\.3 deg/s is 0 with 0 decimals; nothing was sent"):
        driver.set_rate(0.3)
    port.finish()


def test_zaber_without_get_vel_takes_the_rate_from_the_way() -> None:
    clock, table = VirtualClock(), IdealTable()
    line = LoopTransport(zaber.ZaberResponder(table))
    driver = zaber.ZaberTable(line, clock, zaber.Options(reads_velocity=False, timeout_s=0.004))
    driver.start()
    assert math.isnan(driver.read().rate_dps)
    clock.sleep(0.5)
    table.angle_deg += 6.25
    assert driver.read().rate_dps == pytest.approx(12.5, abs=1e-2)
    assert not any(b"get vel" in sent for sent in line.sent)


def test_json_lines_watchdog_stops_a_table_that_nobody_asks() -> None:
    clock, table = VirtualClock(), IdealTable()
    table.read = lambda: TableReading(clock.now_s(), table.rate_dps, table.angle_deg)  # type: ignore[method-assign]
    responder = json_lines.JsonLinesResponder(table)
    driver = json_lines.JsonLinesTable(LoopTransport(responder), clock, json_lines.Options(watchdog_s=2.0))
    driver.start()
    driver.set_rate(30.0)
    for _ in range(5):
        clock.sleep(1.0)
        driver.read()
        responder.feed(b"")
    assert table.rate_dps == 30.0
    clock.sleep(2.1)
    responder.feed(b"")
    assert table.rate_dps == 0.0
    # it stays armed, and a table that was switched off and on is armed again by the next start
    driver.set_rate(30.0)
    clock.sleep(2.1)
    responder.feed(b"")
    assert table.rate_dps == 0.0
    fresh = LoopTransport(json_lines.JsonLinesResponder(table))
    driver = json_lines.JsonLinesTable(fresh, clock)
    driver.limits()
    driver.start()
    assert [b"hello" in sent for sent in fresh.sent] == [True, True]


def test_json_lines_conversation() -> None:
    port = ScriptedTransport(
        (
            b'{"command": "hello", "watchdog_s": 10.0}\n',
            b'{"ok": true, "max_rate_dps": 100, "max_acceleration_dps2": 20}\n',
        ),
        (b'{"command": "set_rate", "rate_dps": 10.0}\n', b'{"ok": true, "rate_dps": 9.9}\n'),
        (b'{"command": "read"}\n', b'{"ok": true, "rate_dps": 9.9, "angle_deg": 1, "faults": ["hot"]}\n'),
        (b'{"command": "stop"}\n', b""),
    )
    driver = json_lines.JsonLinesTable(port, CLOCK, json_lines.Options(timeout_s=0.004))
    driver.start()
    assert driver.set_rate(10.0) == 9.9
    assert driver.faults() == ("hot",)
    driver.send_stop()
    port.finish()


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (b"garbage\n", "which is not JSON"),
        (b'{"ok": false, "error": "too hot"}\n', r"refused read \(too hot\)"),
        (b'{"ok": true, "rate_dps": "fast"}\n', "rate_dps is 'fast'"),
    ],
)
def test_json_lines_refuses(answer: bytes, text: str) -> None:
    port = ScriptedTransport((b'{"command": "read"}\n', answer))
    with pytest.raises(DeviceError, match=text):
        json_lines.JsonLinesTable(port, CLOCK, json_lines.Options(timeout_s=0.004)).read()


def test_manual_table_asks_until_it_gets_a_number() -> None:
    clock = VirtualClock()
    answers = iter(["0", "what", "nan", "10.02", "0.3", "0", "5"])
    driver = manual.ManualTable(lambda _: next(answers), clock)
    assert math.isnan(driver.read().rate_dps), "nobody has said yet that it stands"
    driver.start()
    assert driver.set_rate(10.0) == 10.02
    assert driver.set_rate(10.0) == 10.02, "asked once for a rate that stays"
    clock.sleep(2.0)
    assert driver.read().angle_deg == pytest.approx(20.04)
    driver.send_stop()
    assert driver.read().rate_dps == 0.3
    for _ in range(3):
        driver.send_stop()
    assert driver.read().rate_dps == 0.0, "told to stop until it stands, and not after that"
    assert driver.set_rate(5.0) == 5.0
    with pytest.raises(DeviceError, match="beyond the limit"):
        driver.set_rate(200.0)


def test_manual_table_without_an_operator() -> None:
    def gone(_: str) -> str:
        raise EOFError

    with pytest.raises(InterruptedRunError, match="terminal is gone"):
        manual.ManualTable(gone, CLOCK).start()
