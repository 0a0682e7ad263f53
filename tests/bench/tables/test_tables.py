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


#: Sets what is set already: its answer is no number.
AEROSMITH_SYNC = (b"ACL100\r", b"\r\n>")


def test_aerosmith_conversation_with_an_owed_answer() -> None:
    port = ScriptedTransport(
        AEROSMITH_SYNC,
        (b"PVE\r", b"0.000\r\n>"),
        AEROSMITH_SYNC,
        (b"JOG-30\r", b""),
        (b"ACL100\r", b"\r\n>\r\n>"),  # the first is that to JOG
        (b"PVE\r", b"PVE -29.998\r\n>"),
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
    port = ScriptedTransport(AEROSMITH_SYNC, (b"PVE\r", b"?\r\n>"))
    with pytest.raises(DeviceError, match="did not understand 'PVE'"):
        aerosmith.AerosmithTable(port, CLOCK, aerosmith.Options(timeout_s=0.004)).start()


@pytest.mark.parametrize(
    ("text", "check"), [("1 0 move vel 10000", "30"), ("1 get pos", "FD"), ("01 0 OK IDLE -- 0", "8D")]
)
def test_zaber_checksum_vectors(text: str, check: str) -> None:
    assert zaber.lrc(text) == check


def zaber_message(body: str) -> bytes:
    return f"/{body}:{zaber.lrc(body)}\r\n".encode()


def zaber_reply(body: str) -> bytes:
    return f"@{body}:{zaber.lrc(body)}\r\n".encode()


def test_zaber_conversation() -> None:
    port = ScriptedTransport(
        (zaber_message("1 1 01 move vel 17476"), b"#01 1 note\r\n" + zaber_reply("01 1 01 OK BUSY -- 0")),
        (zaber_message("1 1 02"), b"@01 1 02 OK BUSY WS 0\r\n"),
        (zaber_message("1 1 03 stop"), b""),
    )
    driver = zaber.ZaberTable(port, CLOCK, zaber.Options(timeout_s=0.004))
    assert driver.set_rate(10.0) == pytest.approx(9.99985, abs=1e-5)
    assert driver.faults() == ("Zaber warning flag WS (stalled, with recovery)",)
    driver.send_stop()
    port.finish()


def zaber_at(*flags: str) -> zaber.ZaberTable:
    """A driver and a stage that answers its requests with these states and flags."""

    class Stage:
        def __init__(self) -> None:
            self.flags = iter(flags)

        def feed(self, data: bytes) -> bytes:
            number = data.split()[2].partition(b":")[0].decode()
            return zaber_reply(f"01 1 {number} OK {next(self.flags)} 0") if b"stop" not in data else b""

    return zaber.ZaberTable(LoopTransport(Stage()), CLOCK, zaber.Options(timeout_s=0.004))


def test_zaber_goes_from_rate_to_rate_although_that_interrupts_its_movement() -> None:
    driver = zaber_at("IDLE --", "BUSY --", "BUSY NI", "BUSY NI", "BUSY NI", "IDLE NI", "BUSY --", "BUSY --")
    driver.start()
    driver.set_rate(10.0)
    driver.set_rate(20.0)
    assert driver.faults() == ()
    driver.send_stop()
    assert driver.faults() == ()
    assert driver.faults() == (), "NI stays after the stop"
    driver.set_rate(5.0)
    assert driver.faults() == ()


@pytest.mark.parametrize("flag", ["NI", "NC"])
def test_zaber_names_somebody_at_the_knob(flag: str) -> None:
    driver = zaber_at("IDLE --", "BUSY --", f"BUSY {flag}")
    driver.start()
    driver.set_rate(10.0)
    (fault,) = driver.faults()
    assert f"warning flag {flag} (" in fault
    assert "somebody turns the knob" in fault


def test_zaber_takes_a_flag_that_was_there_before_for_what_it_is() -> None:
    driver = zaber_at("IDLE NI", "IDLE NI", "BUSY --", "BUSY NI")
    driver.start()
    assert driver.faults() == (), "a program before us was killed while the stage turned"
    driver.set_rate(10.0)
    assert "knob" in driver.faults()[0]


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (b"@01 1 01 RJ IDLE -- BADDATA\r\n", r"rejected .* \(BADDATA\)"),
        (b"@02 1 01 OK IDLE -- 0\r\n", "one that does not fit it"),  # of another device
        (b"@01 1 01 OK IDLE -- 0:00\r\n", "one that does not fit it"),  # damaged
        (b"@01 1 98 OK IDLE -- 7\r\n", "one that does not fit it"),  # to another request
        (b"@01 1 01 OK IDLE -- x\r\n", "a number is wanted"),
    ],
)
def test_zaber_refuses(answer: bytes, text: str) -> None:
    port = ScriptedTransport((zaber_message("1 1 01 get vel"), answer))
    with pytest.raises(DeviceError, match=text):
        zaber.ZaberTable(port, CLOCK, zaber.Options(timeout_s=0.004)).read()


#: The interlock's answer is a word.
ACUTROL_SYNC = (b":Interlock? 1\r\n", b"00000006Closed\r\n")


def test_acutrol_conversation_and_latched_fault() -> None:
    port = ScriptedTransport(
        ACUTROL_SYNC,
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
        (b"0113000bnot recognised\r\n", "error 113 to ':Read:Rate"),
        (b"OK\r\n", "does not fit it, 'OK'.* Check cable, baud rate and options"),
        (b"00000002OK\r\n", "does not fit it, '00000002OK'"),
    ],
)
def test_acutrol_refuses(answer: bytes, text: str) -> None:
    port = ScriptedTransport(ACUTROL_SYNC, (b":Read:Rate? 1\r\n", answer))
    with pytest.raises(DeviceError, match=text):
        acutrol.AcutrolTable(port, CLOCK, acutrol.Options(timeout_s=0.004)).read()


def test_acutrol_split_of_the_prefix_is_an_option() -> None:
    options = acutrol.Options(prefix_characters=5, code_characters=2, timeout_s=0.004)
    port = ScriptedTransport(
        (b":Interlock? 1\r\n", b"00006Closed\r\n"),
        (b":Read:Rate? 1\r\n", b"000039.5\r\n"),
        (b":Read:Position? 1\r\n", b"000011\r\n"),
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
            b'{"command": "hello", "watchdog_s": 10.0, "id": 1}\n',
            b'{"ok": true, "max_rate_dps": 100, "max_acceleration_dps2": 20, "id": 1}\n',
        ),
        (
            b'{"command": "set_rate", "rate_dps": 10.0, "id": 2}\n',
            b'{"ok": true, "id": 1}\n{"ok": true, "rate_dps": 9.9, "id": 2}\n',  # a late one first
        ),
        (
            b'{"command": "read", "id": 3}\n',
            b'{"ok": true, "rate_dps": 9.9, "angle_deg": 1, "faults": ["hot"], "id": 3}\n',
        ),
        (b'{"command": "stop", "id": 4}\n', b""),
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
        (b"garbage\n", "one that does not fit it, 'garbage'"),
        (b'{"ok": false, "error": "too hot", "id": 1}\n', r"refused read \(too hot\)"),
        (b'{"ok": true, "rate_dps": "fast", "id": 1}\n', "rate_dps is 'fast'"),
        (b'{"ok": true, "rate_dps": 1.0}\n', "one that does not fit it"),
    ],
)
def test_json_lines_refuses(answer: bytes, text: str) -> None:
    port = ScriptedTransport((b'{"command": "read", "id": 1}\n', answer))
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
