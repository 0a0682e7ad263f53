"""From a profile to real devices: every refusal in its own words, and what stands between a driver and its port."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from gyrocal.bench import session
from gyrocal.bench.capture import RawCapture, decode_capture
from gyrocal.bench.chambers.manual import ManualChamber
from gyrocal.bench.chambers.stepped import AlarmsByHand, SteppedChamber
from gyrocal.bench.clock import RealClock, VirtualClock
from gyrocal.bench.conversation import Conversation, ended_by
from gyrocal.bench.devices import ChamberReading
from gyrocal.bench.profile import Profile, profile_from_dict
from gyrocal.bench.session import AcquireConfig, acquire, connect
from gyrocal.bench.tables.manual import ManualTable
from gyrocal.bench.transport import ReopeningTransport, Transport
from gyrocal.bench.wiring import open_bench, read_wire
from gyrocal.errors import DeviceError, InputError, InterruptedRunError, OutputError, ProfileError
from gyrocal.records.journal import Recovered
from gyrocal.records.raw import RawWriter, iterate_raw
from gyrocal.records.run import read_run
from tests.bench.test_resume import start, toml
from tests.bench.tiny import Silent, tiny
from tests.bench.wire import IdealChamber, LoopTransport

REAL: dict[str, Any] = {
    "gyro": {"device": "kvh-frame-a:/dev/ttyUSB0"},
    "table": {"device": "zaber:/dev/ttyUSB1"},
    "chamber": {"device": "espec:socket://10.0.0.5:10001"},
}


def profile(**changes: Any) -> Profile:
    """The tiny profile on real ports."""
    return profile_from_dict(tiny(**{**REAL, **changes}), "p.toml")


def test_a_profile_names_kinds_ports_and_options() -> None:
    p = profile(gyro={"device": "kvh-frame-b:/dev/x", "baud": 460800, "options": {"axis": "x"}})
    wire = read_wire(p, "gyro")
    assert (wire.kind, wire.url, wire.baud, wire.options.axis) == ("kvh-frame-b", "/dev/x", 460800, "x")
    assert wire.options.data_rate_hz == 10.0  # the sensor's
    assert read_wire(p, "table").baud == 115200
    assert read_wire(p, "chamber").url == "socket://10.0.0.5:10001"
    bench = open_bench(p, RealClock(), lambda question: "")  # no port is opened yet
    assert bench.describe == "gyro kvh-frame-b, table zaber, chamber espec"
    assert isinstance(bench.chamber, SteppedChamber)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {"gyro": {"device": "kvh:/dev/x"}},
            'p.toml: gyro.device is "kvh:/dev/x", and allowed is "virtual" or "kind:port" with one of the kinds '
            "kvh-ecore2000, kvh-dsp3000, kvh-frame-a, kvh-frame-b, vn100, ascii-line.",
        ),
        (
            {"gyro": {"device": "manual"}},
            'p.toml: gyro.device is "manual", and allowed is "virtual" or "kind:port"',
        ),
        (
            {"table": {"device": "zaber"}},
            'p.toml: table.device is "zaber", and allowed is "virtual", "manual" or',
        ),
        (
            {"table": {"device": "virtual"}},
            'p.toml: table.device is "virtual" and gyro.device is "kvh-frame-a:/dev/ttyUSB0". Make all three virtual '
            "or none; gyrocal sim serves virtual devices on ports.",
        ),
        (
            {"chamber": {"device": "espec:/dev/x", "options": {"adress": 1}}},
            "p.toml: chamber.options.adress is an unknown key. Did you mean address?",
        ),
        (
            {"gyro": {"device": "kvh-frame-a:/dev/x", "options": {"data_rate_hz": 100.0}}},
            "p.toml: gyro.options.data_rate_hz is 100.0, and allowed is sensor.sample_rate_hz (10 Hz).",
        ),
        (
            {"gyro": {"device": "kvh-frame-a:/dev/x", "baud": 1200}},
            "p.toml: kvh-frame-a at 10 Hz needs 3600 baud, and gyro.baud is 1200. Raise the baud rate on both sides, or "
            "lower the data rate.",
        ),
        (
            {"gyro": {"device": "kvh-ecore2000:/dev/x"}},
            "p.toml: gyro.options.lsb_dps is missing; it wants a number from 1e-09 to 10 deg/s.",
        ),
        (
            {"gyro": {"device": "ascii-line:/dev/x", "options": {"columns": ["a", 1]}}},
            "p.toml: gyro.options.columns is 1, and allowed is a list of texts (in the list).",
        ),
        (
            {"gyro": {"device": "ascii-line:/dev/x", "options": {"columns": ["a"]}}},
            "p.toml: gyro.options.columns must name rate once",
        ),
        (
            {"gyro": {"device": "ascii-line:/dev/x", "options": {"rate_unit": "rpm"}}},
            'p.toml: gyro.options.rate_unit is "rpm", and allowed is one of "deg/s", "rad/s"',
        ),
        (
            {"gyro": {"device": "kvh-frame-a:/dev/x", "options": {"axis": "w"}}},
            'p.toml: gyro.options.axis is "w", and allowed is one of "x", "y", "z".',
        ),
        (
            {"gyro": {"device": "kvh-dsp3000:/dev/x"}, "table": {"device": "zaber:/dev/x"}},
            'p.toml: table.device is "zaber:/dev/x", and allowed is a port other than that of gyro.',
        ),
        (
            {"chamber": {"device": "weiss:/dev/z"}},
            "p.toml: nothing sets the own alarms of a weiss chamber, which protect the gyro when this computer is dead. Set "
            "them to -45 and 80 °C at its panel and say own_alarms_set = true in [chamber].",
        ),
        (
            {"gyro": {"device": "kvh-dsp3000:/dev/x"}, "chamber": {"device": "manual"}},
            "p.toml: a kvh-dsp3000 sends no temperature and a manual chamber has no thermometer that this program reads, so "
            "that no interlock keeps the gyro from harm. Watch its temperature yourself and say no_thermometer = true in "
            "[safe], or use a chamber with a link.",
        ),
        (
            {"table": {"device": "json-lines:/dev/y"}, "record": {"bench_period_s": 8.0}},
            "p.toml: record.bench_period_s is 8 s, and the table stops by itself when it is not asked for 10 s. Give at "
            "most 5 s, or raise watchdog_s in [table.options].",
        ),
        (
            {"gyro": {"device": "kvh-frame-a:/dev/x", "baud": 7}},
            "p.toml: gyro.baud is 7, and allowed is a whole number from 50 to 1e+07 baud.",
        ),
    ],
)
def test_a_wrong_device_is_refused_before_anything_is_opened(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ProfileError) as caught:
        connect(profile(**changes), simulate=False)
    assert str(caught.value).startswith(text)


def test_a_bench_without_a_thermometer_is_confirmed_and_told() -> None:
    p = profile(
        gyro={"device": "kvh-dsp3000:/dev/x"}, chamber={"device": "manual"}, safe__no_thermometer=True
    )
    assert connect(p, simulate=False)[0].describe == "gyro kvh-dsp3000, table zaber, chamber manual"
    assert any(
        "safe.no_thermometer is true" in note and "has to watch it" in note
        for note in p.notes(date(2026, 1, 1))
    )
    # a thermometer of its own needs no such word
    ecore = {"lsb_dps": 0.00183, "temperature_byte": 1}
    with_one = {"device": "kvh-ecore2000:/dev/x", "options": ecore}
    connect(profile(gyro=with_one, chamber={"device": "manual"}), simulate=False)


def test_simulate_takes_no_port() -> None:
    assert connect(profile(), simulate=True)[0].describe == "virtual"


def test_manual_devices_ask_the_operator() -> None:
    asked: list[str] = []

    def operator(question: str) -> str:
        asked.append(question)
        return "21.5"

    p = profile(table={"device": "manual"}, chamber={"device": "manual", "options": {"max_temp_c": 40.0}})
    bench = open_bench(p, RealClock(), operator)
    assert isinstance(bench.table, ManualTable)
    assert isinstance(bench.chamber, ManualChamber)
    assert bench.chamber.limits().max_temp_c == 40.0
    bench.chamber.start()
    assert bench.chamber.read().temp_c == 21.5
    assert asked == ["Switch the chamber on, then type the temperature it shows (deg C): "]


def test_nobody_at_the_terminal(tmp_path: Path) -> None:
    bench, *_ = connect(profile(table={"device": "manual"}), simulate=False)
    with pytest.raises(
        InterruptedRunError, match="A manual device asks, and nobody is there to answer: Make sure"
    ):
        bench.table.start()


def test_a_missing_port_is_told_before_a_run_moves(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text(toml(tiny(**{**REAL, "table": {"device": f"json-lines:{tmp_path}/none"}})))
    with pytest.raises(DeviceError, match=r"there is no such port\. Check the cable and the name"):
        acquire(AcquireConfig(path, tmp_path / "r"), Silent())
    assert not (tmp_path / "r").exists()


# chambers without a ramp, or without alarms


class Slow(IdealChamber):
    """A chamber whose air is always at 20 deg C, and that keeps its set points."""

    def __init__(self) -> None:
        super().__init__()
        self.heard: list[float] = []
        self.clock = VirtualClock()

    def set_setpoint(self, temp_c: float, ramp_c_per_min: float | None = None) -> None:
        assert ramp_c_per_min is None
        if not -40.0 <= temp_c <= 85.0:
            raise DeviceError("out of range")
        self.heard.append(temp_c)
        super().set_setpoint(temp_c)

    def read(self) -> ChamberReading:
        return ChamberReading(self.clock.now_s(), 20.0, self.setpoint_c, True)


@pytest.mark.parametrize("target_c", [26.0, 14.0, 26.04])
def test_a_set_point_is_led_along_the_ramp(target_c: float) -> None:
    slow = Slow()
    chamber = SteppedChamber(slow, slow.clock)
    chamber.set_setpoint(target_c, 2.0)
    for _ in range(240):
        slow.clock.sleep(1.0)
        due_c = min(abs(target_c - 20.0), slow.clock.now_s() / 30.0)
        assert abs(chamber.read().setpoint_c - 20.0) == pytest.approx(due_c, abs=0.16)
    assert slow.heard[-1] == target_c
    assert len(slow.heard) < 70  # a tenth of a degree at a time, and nothing more once it is there
    chamber.set_setpoint(22.0)
    assert slow.heard[-1] == 22.0


@pytest.mark.parametrize("restarted", [False, True])
def test_a_ramp_is_forgotten_at_a_safe_set_point_and_a_restart(restarted: bool) -> None:
    slow = Slow()
    chamber = SteppedChamber(slow, slow.clock)
    chamber.set_setpoint(60.0, 2.0)
    slow.clock.sleep(60.0)
    chamber.read()
    if restarted:
        chamber.start()
    else:
        chamber.set_setpoint(22.0)
    heard = list(slow.heard)
    slow.clock.sleep(600.0)
    chamber.read()
    assert slow.heard == heard


def test_a_ramp_beyond_the_limits_is_refused() -> None:
    slow = Slow()
    with pytest.raises(DeviceError, match="out of range"):
        SteppedChamber(slow, slow.clock).set_setpoint(200.0, 2.0)


def test_alarms_set_by_hand_are_not_sent() -> None:
    inner = IdealChamber()
    chamber = AlarmsByHand(inner)
    chamber.set_alarm_limits(-45.0, 80.0)
    assert inner.alarm_limits is None
    p = profile(chamber={"device": "weiss:/dev/x", "own_alarms_set": True})
    assert isinstance(open_bench(p, RealClock(), lambda question: "").chamber, AlarmsByHand)


# ports


class Flaky:
    """Opens ports that can be pulled out."""

    def __init__(self) -> None:
        self.opened = 0
        self.there = True

    def __call__(self) -> Transport:
        if not self.there:
            raise DeviceError("there is no such port")
        self.opened += 1
        return Pulled(self)


class Pulled(LoopTransport):
    """A port of a `Flaky`."""

    def __init__(self, flaky: Flaky) -> None:
        super().__init__(self)
        self.flaky = flaky

    def feed(self, data: bytes) -> bytes:
        return data

    def write(self, data: bytes) -> None:
        if not self.flaky.there:
            raise DeviceError("the port is gone")
        super().write(data)


def test_a_port_is_opened_at_its_first_use_and_again_when_it_was_gone() -> None:
    flaky = Flaky()
    port = ReopeningTransport(flaky)
    assert flaky.opened == 0
    port.write(b"a")
    assert (port.read_available(0.1), flaky.opened) == (b"a", 1)
    flaky.there = False
    for text in ("the port is gone", "there is no such port", "there is no such port"):
        with pytest.raises(DeviceError, match=text):
            port.write(b"b")
    flaky.there = True
    port.write(b"c")
    assert (port.read_available(0.1), flaky.opened) == (b"c", 2)


def test_an_answer_without_an_end_is_not_waited_for() -> None:
    class Endless(LoopTransport):
        def read_available(self, wait_s: float) -> bytes:
            return b"\x55" * 512 if self.sent else b""

        def write(self, data: bytes) -> None:
            self.sent.append(data)

    talk = Conversation(Endless(Pulled(Flaky())), "table", ended_by(b"\n"), 1.0)
    with pytest.raises(
        DeviceError, match=r"table: \d+ bytes came and no end of an answer to 'X' .*Check the baud"
    ):
        talk.ask(b"X", lambda answer: answer)


# captures


def test_a_capture_keeps_both_directions_and_decodes_one(tmp_path: Path) -> None:
    clock = RealClock()
    for number in (1, 2):
        capture = RawCapture(clock)
        tap = capture.tap("gyro", "kvh-dsp3000", {})
        capture.start(tmp_path / "raw")
        tap(b">", b"RRR")
        tap(b"<", b"\r\n       0.015733   1\r\n")
        capture.close()
        assert capture.failure is None
        path = tmp_path / "raw" / f"gyro-{number}.raw"
        assert path.read_text().splitlines()[1].endswith(" >525252")
        assert [data for _, data in iterate_raw(path)] == [b"\r\n       0.015733   1\r\n"]
        decoded = decode_capture(path, tmp_path / f"{number}.csv")
        assert (decoded.health.frames_good, decoded.duration_s, decoded.cut_off) == (1, 0.0, False)
        path.write_bytes(path.read_bytes()[:-3])
        assert decode_capture(path, tmp_path / f"{number}.csv").cut_off


def test_a_capture_on_a_full_disk_ends_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: RawWriter, t_s: float, data: bytes, *, sent: bool = False) -> None:
        raise OutputError("the disk is full")

    monkeypatch.setattr(RawWriter, "chunk", full)
    capture = RawCapture(RealClock())
    tap = capture.tap("gyro", "vn100", {})
    watch = Silent()
    with session._capturing(capture, tmp_path, watch):
        tap(b"<", b"x")
    assert watch.said == ["the raw capture is incomplete: the disk is full"]


# clocks


@pytest.mark.parametrize("jump_s", [-3600.0, 3600.0])
def test_a_step_of_the_host_clock_changes_nothing(monkeypatch: pytest.MonkeyPatch, jump_s: float) -> None:
    clock = RealClock()
    real: Callable[[], float] = time.time
    before_s = clock.now_s()
    monkeypatch.setattr(time, "time", lambda: real() + jump_s)
    assert 0.0 <= clock.now_s() - before_s < 60.0


@pytest.mark.parametrize(
    ("began_ago_s", "expected_s"),
    [
        (7200.0, 7200.0),
        (10.0, 561.0),
        (-9e6, 561.0),
        (1.8e9, 561.0),  # it was begun on a computer whose clock was not set
    ],
)
def test_a_run_is_carried_on_after_all_that_was_recorded(
    tmp_path: Path, began_ago_s: float, expected_s: float
) -> None:
    path = tmp_path / "p.toml"
    path.write_text(toml(tiny()))
    start(path, tmp_path / "r")
    began = (datetime.now(UTC) - timedelta(seconds=began_ago_s)).strftime("%Y-%m-%dT%H:%M:%SZ")
    head = tmp_path / "r" / "run.json"
    head.write_text(head.read_text().replace("2000-01-01T00:00:00Z", began))
    found = Recovered({}, 500.5, 0, 0, (), ())
    config = AcquireConfig(path, tmp_path / "r")
    again_s = session._start_again_s(config, profile(), read_run(tmp_path / "r"), found)
    assert again_s == pytest.approx(expected_s, abs=30.0)


@pytest.mark.parametrize("began", ["2000-01-01T00:00:00", "yesterday", ""])
def test_a_beginning_that_was_edited_by_hand_hinders_no_resume(tmp_path: Path, began: str) -> None:
    path = tmp_path / "p.toml"
    path.write_text(toml(tiny()))
    start(path, tmp_path / "r")
    head = tmp_path / "r" / "run.json"
    head.write_text(head.read_text().replace("2000-01-01T00:00:00Z", began))
    found = Recovered({}, 500.5, 0, 0, (), ())
    config = AcquireConfig(path, tmp_path / "r")
    again_s = session._start_again_s(config, profile(), read_run(tmp_path / "r"), found)
    assert again_s == 561.0


def test_a_capture_that_is_none_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.raw"
    RawWriter(path, "gyro", {}).close()
    with path.open("a") as f:
        f.write("0.5 >zz\n")
    with pytest.raises(InputError, match="line 2: is not a time and bytes"):
        list(iterate_raw(path))
