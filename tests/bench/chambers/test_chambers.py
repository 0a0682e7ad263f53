"""Chamber drivers against scripted conversations, protocol vectors, and the same wire seen from the device."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrocal.bench.chambers import espec, manual, modbus, watlow_f4, watlow_f4t, weiss
from gyrocal.bench.clock import VirtualClock
from gyrocal.bench.devices import Chamber
from gyrocal.bench.transport import Transport
from gyrocal.errors import DeviceError, InterruptedRunError
from tests.bench.wire import IdealChamber, LoopTransport, Responder, ScriptedTransport

CLOCK = VirtualClock()

MakeDriver = Callable[[Transport], Chamber]
MakeResponder = Callable[[Chamber], Responder]

CHAMBERS: dict[str, tuple[MakeDriver, MakeResponder]] = {
    "espec": (lambda t: espec.EspecChamber(t, CLOCK, espec.Options(timeout_s=0.004)), espec.EspecResponder),
    "watlow_f4": (
        lambda t: watlow_f4.WatlowF4Chamber(t, CLOCK, watlow_f4.Options(timeout_s=0.004, condition_event=1)),
        watlow_f4.watlow_f4_responder,
    ),
    "watlow_f4t_scpi": (
        lambda t: watlow_f4t.WatlowF4tScpiChamber(t, CLOCK, watlow_f4t.Options(timeout_s=0.004)),
        watlow_f4t.WatlowF4tScpiResponder,
    ),
    "watlow_f4t_modbus": (
        lambda t: watlow_f4t.WatlowF4tModbusChamber(t, CLOCK, watlow_f4t.Options(timeout_s=0.004)),
        watlow_f4t.watlow_f4t_modbus_responder,
    ),
    "weiss": (lambda t: weiss.WeissChamber(t, CLOCK, weiss.Options(timeout_s=0.004)), weiss.WeissResponder),
}
chambers = pytest.mark.parametrize("name", CHAMBERS)


@chambers
@pytest.mark.parametrize("temp_c", [-39.9, -10.0, 0.0, 83.8])
def test_setpoint_goes_through_the_wire_unrounded_and_comes_back(name: str, temp_c: float) -> None:
    chamber = IdealChamber()
    driver = CHAMBERS[name][0](LoopTransport(CHAMBERS[name][1](chamber)))
    driver.start()
    driver.set_setpoint(temp_c)
    assert chamber.setpoint_c == pytest.approx(temp_c, abs=1e-5)
    reading = driver.read()
    assert reading.temp_c == pytest.approx(temp_c, abs=1e-5)
    assert reading.setpoint_c == pytest.approx(temp_c, abs=1e-5)
    assert reading.alarms == ()


@chambers
def test_alarms_are_seen(name: str) -> None:
    chamber = IdealChamber()
    options = weiss.Options(timeout_s=0.004, fault_bit=5)
    make = CHAMBERS[name]
    driver = make[0](LoopTransport(make[1](chamber)))
    if name == "weiss":
        driver = weiss.WeissChamber(LoopTransport(weiss.WeissResponder(chamber, options)), CLOCK, options)
    driver.start()
    chamber.alarms = ("door",)
    assert driver.read().alarms


@chambers
def test_a_setpoint_outside_the_limits_is_refused_before_anything_is_sent(name: str) -> None:
    transport = LoopTransport(CHAMBERS[name][1](IdealChamber()))
    with pytest.raises(
        DeviceError, match=r"set point of 200 deg C is outside its limits .* nothing was sent"
    ):
        CHAMBERS[name][0](transport).set_setpoint(200.0)
    assert transport.sent == []


@chambers
def test_own_alarm_limits_are_set_or_plainly_refused(name: str) -> None:
    chamber = IdealChamber()
    driver = CHAMBERS[name][0](LoopTransport(CHAMBERS[name][1](chamber)))
    driver.start()
    if name == "espec":
        driver.set_alarm_limits(-15.0, 55.0)
        assert chamber.alarm_limits == (-15.0, 55.0)
    else:
        with pytest.raises(DeviceError, match="own_alarms_set = true"):
            driver.set_alarm_limits(-15.0, 55.0)


def test_watlow_f4_alarm_registers_by_option() -> None:
    chamber = IdealChamber()
    options = watlow_f4.Options(timeout_s=0.004, alarm_registers=True)
    driver = watlow_f4.WatlowF4Chamber(LoopTransport(watlow_f4.watlow_f4_responder(chamber)), CLOCK, options)
    driver.start()
    driver.set_alarm_limits(-15.0, 55.0)
    assert chamber.alarm_limits == (-15.0, 55.0)


@chambers
def test_silence_is_named(name: str) -> None:
    class Deaf:
        def feed(self, data: bytes) -> bytes:
            return b""

    with pytest.raises(DeviceError, match=r"no answer to .* Check power, cable, baud rate and address"):
        CHAMBERS[name][0](LoopTransport(Deaf())).read()


@chambers
def test_a_setpoint_that_is_not_shown_is_an_error(name: str) -> None:
    class Stubborn(IdealChamber):
        def set_setpoint(self, temp_c: float, ramp_c_per_min: float | None = None) -> None:
            pass

    driver = CHAMBERS[name][0](LoopTransport(CHAMBERS[name][1](Stubborn())))
    driver.start()
    with pytest.raises(DeviceError, match=r"was given a set point of 40 deg C and shows 23\.4"):
        driver.set_setpoint(40.0)


@chambers
@given(data=st.binary(max_size=200))
def test_a_garbled_answer_is_a_device_error(name: str, data: bytes) -> None:
    class Garbling:
        def feed(self, _: bytes) -> bytes:
            return b"~" + data

    with pytest.raises(DeviceError):
        CHAMBERS[name][0](LoopTransport(Garbling())).set_setpoint(20.0)


@chambers
@given(data=st.binary(max_size=200))
def test_a_responder_survives_any_bytes(name: str, data: bytes) -> None:
    responder = CHAMBERS[name][1](IdealChamber())
    responder.feed(data)
    responder.feed(b"\r\n" + b"\0" * 300)
    responder.feed(b"\r\n")
    CHAMBERS[name][0](LoopTransport(responder)).start()


@pytest.mark.parametrize(
    ("made", "wire"),
    [
        (modbus.read_request(1, 100, 1), "01 03 00 64 00 01 C5 D5"),
        (modbus.frame(bytes.fromhex("01 03 02 00 EA")), "01 03 02 00 EA 39 CB"),
        (modbus.frame(bytes.fromhex("01 03 02 FE 70")), "01 03 02 FE 70 F9 C0"),
        (modbus.write_request(1, 300, [250]), "01 06 01 2C 00 FA C9 BC"),
        (modbus.write_request(1, 300, [-400]), "01 06 01 2C FE 70 08 7B"),
        (modbus.read_request(1, 101, 1), "01 03 00 65 00 01 94 15"),
        (modbus.read_request(1, 606, 1), "01 03 02 5E 00 01 E4 60"),
        (modbus.read_request(1, 602, 2), "01 03 02 5A 00 02 E5 A0"),
        (modbus.frame(bytes.fromhex("01 83 02")), "01 83 02 C0 F1"),
        (modbus.read_request(1, 2820, 2), "01 03 0B 04 00 02 87 EE"),
        (modbus.frame(bytes.fromhex("01 03 04 00 00 41 C8")), "01 03 04 00 00 41 C8 CB F5"),
        (
            modbus.write_request(1, 2782, watlow_f4t.float_to_words(25.0, True)),
            "01 10 0A DE 00 02 04 00 00 41 C8 30 19",
        ),
        (modbus.frame(bytes.fromhex("01 10 0A DE 00 02")), "01 10 0A DE 00 02 22 2A"),
    ],
)
def test_modbus_vectors(made: bytes, wire: str) -> None:
    assert made == bytes.fromhex(wire)


def _master(*script: tuple[bytes, bytes]) -> tuple[modbus.ModbusMaster, ScriptedTransport]:
    port = ScriptedTransport(*script)
    return modbus.ModbusMaster(port, CLOCK, "F4", 1, 0.004, (100, 3)), port


#: The resynchronising question of the F4, which comes first, and after each failure.
SYNC = (modbus.read_request(1, 100, 3), modbus.frame(bytes([1, 3, 6, 0, 234, 0, 0, 0, 0])))


def test_modbus_read_is_repeated_once_and_a_write_never() -> None:
    request, answer = modbus.read_request(1, 100, 1), bytes.fromhex("010302FE70F9C0")
    master, port = _master(SYNC, (request, b""), SYNC, (request, answer))
    assert [modbus.signed(w) for w in master.read(100)] == [-400]
    port.finish()
    master, port = _master(SYNC, (modbus.write_request(1, 300, [250]), b""))
    with pytest.raises(DeviceError, match="no answer"):
        master.write(300, [250])
    port.finish()


def test_a_late_answer_of_another_register_is_not_taken() -> None:
    mode, setpoint = (modbus.frame(bytes([1, 3, 2, 0, value])) for value in (3, 250))
    master, port = _master(
        SYNC,
        (modbus.read_request(1, 200, 1), b""),
        (SYNC[0], mode + SYNC[1]),
        (modbus.read_request(1, 200, 1), b""),
        (SYNC[0], mode + SYNC[1]),
        (modbus.read_request(1, 300, 1), setpoint),
    )
    with pytest.raises(DeviceError, match="no answer"):
        master.read(200)
    assert master.read(300) == [250]
    port.finish()


def test_the_controller_is_left_alone_after_a_write() -> None:
    clock = VirtualClock()
    request = modbus.write_request(1, 300, [250])
    port = ScriptedTransport(SYNC, (request, request))
    modbus.ModbusMaster(port, clock, "F4", 1, 0.004, (100, 3)).write(300, [250])
    assert clock.now_s() >= 0.03


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        ("01 86 02 C3 A1", r"Modbus exception 2: address"),
        ("01 06 01 2C 00 FB 08 7C", "one that does not fit it, 01 06 01 2c 00 fb 08 7c"),
        ("01 06 01 2C 00 FA C9 BD", "half an answer"),  # its CRC is damaged
        ("02 06 01 2C 00 FA C9 8F", "half an answer"),  # of another device
        ("01 06 01 2C", "half an answer"),
    ],
)
def test_modbus_refuses(answer: str, text: str) -> None:
    master, _ = _master(SYNC, (modbus.write_request(1, 300, [250]), bytes.fromhex(answer)))
    with pytest.raises(DeviceError, match=text):
        master.write(300, [250])


def test_word_order_is_an_option() -> None:
    for first in (True, False):
        words = watlow_f4t.float_to_words(-39.9, first)
        assert watlow_f4t.words_to_float(words, first) == pytest.approx(-39.9, abs=1e-5)
    assert watlow_f4t.float_to_words(25.0, True) == [0x0000, 0x41C8]


def test_espec_conversation() -> None:
    port = ScriptedTransport(
        (b"TYPE?\r\n", b"T,T,S2,160.0\r\n"),
        (b"MODE,CONSTANT\r\n", b"OK:MODE,CONSTANT\r\n"),
        (b"TEMP?\r\n", b"26.4,23.0,140.0,-50.0\r\n"),
        (b"TEMP, S23.0 H100.0 L-40.0\r\n", b"OK:TEMP, S23.0 H100.0 L-40.0\r\n"),
        (b"TEMP?\r\n", b"26.4,23.0,100.0,-40.0\r\n"),  # read back
        (b"TEMP?\r\n", b"26.4,23.0,100.0,-40.0\r\n"),
        (b"MODE?\r\n", b"CONSTANT\r\n"),
        (b"ALARM?\r\n", b"2,1,7\r\n"),
    )
    driver = espec.EspecChamber(port, CLOCK, espec.Options(timeout_s=0.004))
    driver.start()
    driver.set_alarm_limits(-40.0, 100.0)
    assert driver.read().alarms == ("ESPEC alarm 1", "ESPEC alarm 7")
    port.finish()


def test_an_alarm_limit_that_reads_back_as_another_is_an_error() -> None:
    port = ScriptedTransport(
        (b"TYPE?\r\n", b"T,T,S2,160.0\r\n"),
        (b"TEMP?\r\n", b"26.4,23.0,140.0,-50.0\r\n"),
        (b"TEMP, S23.0 H100.0 L-40.0\r\n", b"OK:TEMP, S23.0 H100.0 L-40.0\r\n"),
        (b"TEMP?\r\n", b"26.4,23.0,140.0,-40.0\r\n"),
    )
    driver = espec.EspecChamber(port, CLOCK, espec.Options(timeout_s=0.004))
    with pytest.raises(DeviceError, match="an alarm limit of 100 deg C and shows 140"):
        driver.set_alarm_limits(-40.0, 100.0)
    port.finish()

    class Deaf(watlow_f4.WatlowF4Registers):
        def put(self, register: int, words: list[int]) -> None:
            """Take nothing."""

    f4 = watlow_f4.WatlowF4Chamber(
        LoopTransport(modbus.ModbusSlave(1, Deaf(IdealChamber()))),
        CLOCK,
        watlow_f4.Options(timeout_s=0.004, alarm_registers=True),
    )
    with pytest.raises(DeviceError, match="an alarm limit of -15 deg C and shows -40"):
        f4.set_alarm_limits(-15.0, 55.0)


def test_espec_refusal_is_told_in_its_own_words() -> None:
    port = ScriptedTransport((b"TYPE?\r\n", b"NA:CHB NOT READY\r\n"))
    with pytest.raises(DeviceError, match=r"refused 'TYPE\?' \(CHB NOT READY\)"):
        espec.EspecChamber(port, CLOCK, espec.Options(timeout_s=0.004)).start()


def test_f4t_ramps_by_itself() -> None:
    port = ScriptedTransport(
        (b":SOURCE:CLOOP1:RSCALE MINUTES\n", b""),
        (b":SOURCE:CLOOP1:RRATE 1.500\n", b""),
        (b":SOURCE:CLOOP1:RACTION SETPOINT\n", b""),
        (b":SOURCE:CLOOP1:SPOINT 25.00\n", b""),
        (b"*IDN?\n", b"WATLOW ELECTRIC,F4T,1,1.0\n"),
        (b":SOURCE:CLOOP1:SPOINT?\n", b"25.0000\n"),
    )
    watlow_f4t.WatlowF4tScpiChamber(port, CLOCK, watlow_f4t.Options(timeout_s=0.004)).set_setpoint(25.0, 1.5)
    port.finish()


@pytest.mark.parametrize("blanks", [False, True])
@pytest.mark.parametrize("nominal_first", [False, True])
def test_weiss_writes_back_what_was_there(blanks: bool, nominal_first: bool) -> None:
    options = weiss.Options(
        timeout_s=0.004, nominal_first=nominal_first, blanks_between_digits=blanks, set_values=1
    )
    pair = "0023.0 0022.5" if nominal_first else "0022.5 0023.0"
    digits = "0100" + "0" * 28
    wire = " ".join(digits) if blanks else digits
    state = f"{pair} 0050.0 0050.0 0007.0 {wire}\r".encode()
    humidity = "0050.0"
    port = ScriptedTransport(
        (b"$01I\r", state),
        (f"$01E -010.0 {humidity} 0007.0 {wire}\r".encode(), b""),
        (b"$01I\r", state.replace(b"0023.0", b"-010.0")),
    )
    weiss.WeissChamber(port, CLOCK, options).set_setpoint(-10.0)
    port.finish()


def test_weiss_steps_over_an_answer_to_e_by_option() -> None:
    options = weiss.Options(answers_e=True, timeout_s=0.004)
    chamber = IdealChamber()
    driver = weiss.WeissChamber(LoopTransport(weiss.WeissResponder(chamber, options)), CLOCK, options)
    driver.start()
    driver.set_setpoint(31.5)
    assert chamber.setpoint_c == 31.5
    state = b"0023.0 0023.1 0000.0 0000.0 01" + b"0" * 30 + b"\r"
    port = ScriptedTransport(
        (b"$01I\r", state), (b"$01E 0023.0 0000.0 01" + b"0" * 30 + b"\r", b"0\r"), (b"$01I\r", state)
    )
    weiss.WeissChamber(port, CLOCK, options).set_setpoint(23.0)
    port.finish()


def test_weiss_names_fields_that_do_not_fit() -> None:
    with pytest.raises(DeviceError, match=r"does not fit the options .* Compare with \$01\?"):
        weiss.parse_state("0023.0 0022.5", weiss.Options())


def test_manual_chamber_asks() -> None:
    answers = iter(["21", "", "hot", "nan", "4", "40.2", ""])
    asked: list[str] = []

    def operator(question: str) -> str:
        asked.append(question)
        return next(answers)

    chamber = manual.ManualChamber(operator, CLOCK)
    chamber.start()
    chamber.set_alarm_limits(-15.0, 55.0)
    chamber.set_setpoint(40.0, 1.0)
    assert (chamber.read().temp_c, chamber.read().setpoint_c) == (40.2, 40.0)
    assert asked[-1].startswith(
        "4 deg C is not near 40. Set the chamber to 40 deg C; when it shows that, type"
    )
    # the soak asks for the same again, and the operator need not; the safe set point is not waited for
    chamber.set_setpoint(40.0, 1.0)
    chamber.set_setpoint(23.0)
    assert asked[-1] == "Set the chamber to 23 deg C, then press Enter: "
    assert len(asked) == 7

    def gone(_: str) -> str:
        raise EOFError

    with pytest.raises(InterruptedRunError, match="terminal is gone"):
        manual.ManualChamber(gone, CLOCK).start()
