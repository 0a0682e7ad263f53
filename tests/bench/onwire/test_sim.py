"""Real time: the virtual bench on ports, and the program that acquires from it as from a real one."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from gyrocal.bench.capture import decode_capture
from gyrocal.bench.clock import RealClock
from gyrocal.bench.profile import Profile, profile_from_dict
from gyrocal.bench.safety import StopRequests
from gyrocal.bench.session import AcquireConfig, acquire
from gyrocal.bench.status import read_status
from gyrocal.bench.transport import SerialTransport
from gyrocal.bench.virtual.endpoints import Endpoint, PtyEndpoint, TcpEndpoint
from gyrocal.bench.virtual.serving import Served, serve_profile
from gyrocal.bench.watching import Progress
from gyrocal.calibration.calibrate import FitConfig, calibrate
from gyrocal.errors import DeviceError, InterruptedRunError, OutputError
from gyrocal.records.run import read_run
from tests.bench.test_resume import toml
from tests.bench.test_runner import events
from tests.bench.tiny import Silent, tiny

#: A second a data set; a gyro without thermometer soaks by the chamber alone. The stream's times depend on the load of
#: this computer, so they are not judged here.
SHORT: dict[str, Any] = {
    "plan__temperatures_c": [20.0],
    "plan__dwell_s": 1.0,
    "settle__hold_s": 0.3,
    "settle__tolerance_dps": 0.5,
    "soak__time_s": 1.0,
    "soak__slope_over_s": 10.0,
    "record__bench_period_s": 0.1,
    "sensor__sample_rate_hz": 50.0,
    "stream__clump_share": 1.0,
    "stream__missing_share": 0.3,
    "retry__attempts": 1,
    "safe__chamber_c": 20.0,
    "virtual__start_temp_c": 20.0,
    "virtual__chamber__ripple_c": 0.0,
    "virtual__table__max_acceleration_dps2": 300.0,
}


@contextmanager
def serving(profile: Profile, kinds: dict[str, str | None], folder: Path | None = None) -> Iterator[Served]:
    """A bench on ports in a thread; pseudo-terminals with links in `folder`, else TCP."""

    def endpoint(role: str) -> Endpoint:
        return TcpEndpoint() if folder is None else PtyEndpoint(folder / role)

    served = serve_profile(profile, RealClock(), endpoint, kinds)
    stop = threading.Event()
    thread = threading.Thread(target=served.run, args=(stop,), daemon=True)
    thread.start()
    try:
        yield served
    finally:
        stop.set()
        thread.join(10.0)


@contextmanager
def sim(*arguments: str) -> Iterator[list[str]]:
    """``gyrocal sim`` in a process of its own; yields the lines for the profile."""
    command = [sys.executable, "-u", "-m", "gyrocal", "sim", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            stdout = process.stdout
            assert stdout is not None
            yield list(iter(stdout.readline, "# Serving until Ctrl-C.\n"))
        finally:
            process.send_signal(signal.SIGINT)
            assert process.wait(30.0) == 0


def wired(profile: Profile, served: Served) -> Profile:
    """The profile with the served ports in the place of its devices."""
    devices = tomllib.loads(served.snippet)
    return profile_from_dict({**profile.raw, **devices}, profile.source)


def profile_file(profile: Profile, path: Path) -> Path:
    """A profile as TOML; lists and texts read alike in JSON."""
    path.write_text(toml(json.loads(json.dumps(dict(profile.raw)))))
    return path


@pytest.mark.parametrize("tcp", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_run_against_served_ports(tmp_path: Path, tcp: bool) -> None:
    profile = profile_from_dict(tiny(**SHORT), "short.toml")
    kinds: dict[str, str | None] = {"gyro": "kvh-dsp3000", "table": "zaber", "chamber": "espec"}
    with serving(profile, kinds, None if tcp else tmp_path) as served:
        path = profile_file(wired(profile, served), tmp_path / "wired.toml")
        watch = Silent()
        summary = acquire(AcquireConfig(path, tmp_path / "r", raw=True), watch)
    assert summary.complete, (summary, watch.said)
    run = read_run(tmp_path / "r")
    assert run.bench["devices"] == "gyro kvh-dsp3000, table zaber, chamber espec"
    for segment in run:
        if segment.record.kind == "rate":
            assert segment.record.n > 20
            assert np.mean(segment.gyro_dps) == pytest.approx(segment.record.rate_dps, abs=2.0)
            assert np.isnan(segment.gyro_temp_c).all()
    status = read_status(tmp_path / "r")
    assert (status.state, status.steps) == ("complete", 6)
    assert status.chamber_c == pytest.approx(20.0, abs=0.5)
    # every port was captured, and the gyro's capture decodes to more than the data sets hold
    assert {p.name for p in (tmp_path / "r" / "raw").iterdir()} == {
        "gyro-1.raw",
        "table-1.raw",
        "chamber-1.raw",
    }
    decoded = decode_capture(tmp_path / "r" / "raw" / "gyro-1.raw", tmp_path / "samples.csv")
    assert decoded.health.frames_good >= summary.samples
    assert decoded.health.frames_bad == 0
    assert b">" in (tmp_path / "r" / "raw" / "table-1.raw").read_bytes()


def test_a_port_is_held_by_one_program(tmp_path: Path) -> None:
    endpoint = PtyEndpoint(tmp_path / "port")
    first = SerialTransport(endpoint.address, 9600)
    with pytest.raises(DeviceError, match=r"another program holds the port\. Close it and try again\."):
        SerialTransport(endpoint.address, 9600)
    first.close()
    SerialTransport(endpoint.address, 9600).close()
    endpoint.close()
    with pytest.raises(DeviceError, match="there is no such port"):
        SerialTransport(endpoint.address, 9600)


def test_a_tcp_port_is_held_by_one_gyrocal() -> None:
    endpoint = TcpEndpoint()
    first = SerialTransport(endpoint.address, 9600)
    with pytest.raises(DeviceError, match=r"another gyrocal holds the port\. Wait for it"):
        SerialTransport(endpoint.address, 9600)
    first.close()
    SerialTransport(endpoint.address, 9600).close()
    endpoint.close()
    for _ in range(2):
        with pytest.raises(DeviceError, match="nobody listens there"):
            SerialTransport(endpoint.address, 9600)


@pytest.mark.parametrize("tcp", [False, True])
def test_a_port_that_vanishes_says_so_and_opens_again(tmp_path: Path, tcp: bool) -> None:
    endpoint: Endpoint = TcpEndpoint() if tcp else PtyEndpoint(tmp_path / "port")
    port = SerialTransport(endpoint.address, 9600)
    endpoint.read()
    endpoint.vanish()

    def use() -> None:
        for _ in range(50):
            port.read_available(0.02)
            port.write(b"x")

    with pytest.raises(DeviceError, match="the port is gone"):
        use()
    port.close()
    endpoint.come_back()
    again = SerialTransport(endpoint.address, 9600)
    endpoint.read()
    endpoint.write(b"hello")
    assert again.read_available(2.0) == b"hello"
    again.close()
    endpoint.close()


#: Rates and temperatures enough for all twelve terms, in two minutes.
WHOLE: dict[str, Any] = {
    "plan__temperatures_c": [0.0, 20.0, 40.0],
    "plan__rates_dps": [20.0, 50.0, 80.0],
    "plan__dwell_s": 4.0,
    "plan__temperature_order": "up",
    "ramp__rate_c_per_min": 100.0,
    "soak__time_s": 10.0,
    "soak__slope_over_s": 10.0,
    "soak__slope_c_per_min": 5.0,
    "virtual__start_temp_c": 0.0,
    "virtual__chamber__air_s": 1.0,
    "virtual__chamber__case_s": 2.0,
    "virtual__chamber__max_ramp_c_per_min": 100.0,
    "virtual__gyro__angle_random_walk_deg_per_rt_h": 0.2,
}


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_two_programs_measure_what_one_does(tmp_path: Path) -> None:
    profile = profile_from_dict(tiny(**{**SHORT, **WHOLE}), "whole.toml")
    virtual = profile_file(profile, tmp_path / "virtual.toml")
    with sim("--profile", str(virtual), "--chamber", "watlow-f4t-scpi") as lines:
        wired_path = with_lines(profile, lines, tmp_path / "wired.toml")
        command = [
            sys.executable,
            "-m",
            "gyrocal",
            "acquire",
            str(wired_path),
            "--out",
            str(tmp_path / "wire"),
        ]
        subprocess.run(command, check=True, timeout=800)
    acquire(AcquireConfig(virtual, tmp_path / "process"), Silent())
    wire, process = (calibrate(tmp_path / name, FitConfig()).coefficients for name in ("wire", "process"))
    # Same surface: at none of 15 points do the two differ by more than their uncertainties allow.
    rates, temps = (axis.ravel() for axis in np.meshgrid([-70.0, -30.0, 0.0, 30.0, 70.0], [5.0, 20.0, 35.0]))
    difference = wire.surface.error_dps(rates, temps) - process.surface.error_dps(rates, temps)
    sigma = np.hypot(wire.sigma_dps(rates, temps), process.sigma_dps(rates, temps))
    false_alarm = 1e-4
    assert np.max(np.abs(difference) / sigma) < norm.isf(false_alarm / 2 / rates.size)
    # and the surface itself is larger than that: the comparison says something
    surface = process.surface.error_dps(rates, temps)
    assert np.sqrt(np.mean(surface**2)) > 3.0 * np.sqrt(np.mean(sigma**2))


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_program_that_was_killed_is_carried_on_against_the_same_bench(tmp_path: Path) -> None:
    profile = profile_from_dict(tiny(**{**SHORT, "plan__rates_dps": [20.0, 40.0, 60.0]}), "killed.toml")
    virtual = profile_file(profile, tmp_path / "virtual.toml")
    out = tmp_path / "r"
    with sim("--profile", str(virtual), "--gyro", "kvh-dsp3000") as lines:
        wired_path = with_lines(profile, lines, tmp_path / "wired.toml")
        command = [sys.executable, "-m", "gyrocal", "acquire", str(wired_path), "--out", str(out)]
        resume = [*command, "--resume"]
        for kills in range(3):
            with subprocess.Popen(resume if kills else command, stderr=subprocess.DEVNULL) as process:
                deadline = time.monotonic() + 120.0
                while len(list(out.glob("data/*dps*.csv"))) < 3 + 2 * kills and time.monotonic() < deadline:
                    time.sleep(0.05)
                process.kill()
            assert read_status(out).state == "dead"
        subprocess.run(resume, check=True, timeout=600)
    run = read_run(out)
    plan = [record for record in run.segments if record.id <= 10]
    assert sorted(record.id for record in plan) == list(range(1, 11))
    for segment in run:  # verifies each sha256
        if segment.record.kind == "rate":
            assert np.mean(segment.gyro_dps) == pytest.approx(segment.record.rate_dps, abs=2.0)
    assert read_status(out).state == "complete"


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_a_signal_stops_the_table_on_the_wire(tmp_path: Path, number: signal.Signals) -> None:
    profile = profile_from_dict(tiny(**{**SHORT, "plan__rates_dps": [60.0], "plan__dwell_s": 20.0}), "s.toml")
    out = tmp_path / "r"
    with serving(profile, {"gyro": "kvh-dsp3000", "table": "zaber"}, tmp_path) as served:
        path = profile_file(wired(profile, served), tmp_path / "wired.toml")
        command = [sys.executable, "-m", "gyrocal", "acquire", str(path), "--out", str(out)]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
            deadline = time.monotonic() + 240.0
            while not list(out.glob("data/0004*.part")) and time.monotonic() < deadline:
                time.sleep(0.05)
            process.send_signal(number)
            assert process.stderr is not None
            said = process.stderr.read()
            assert process.wait(120.0) == 130, said
        assert f"Ended by {number.name}; what was sealed is kept" in said
        assert "\nThe table stands. The chamber is set to " in said
        (line,) = events(out, "make_safe")
        assert line["table_stopped"] is True
        assert abs(line["table_rate_dps"]) < 0.05
    assert read_status(out).state == "stopped"


class Terminal:
    """A program on a pseudo-terminal, with somebody who reads and types."""

    def __init__(self, *command: str) -> None:
        self.master, slave = pty.openpty()
        self.process = subprocess.Popen(
            command, stdin=slave, stdout=slave, stderr=slave, start_new_session=True, close_fds=True
        )
        os.close(slave)
        os.set_blocking(self.master, False)
        self.seen = b""

    def read(self, text: bytes, within_s: float = 60.0) -> bytes:
        """What comes until `text` does, and half a second more."""
        deadline, found_s = time.monotonic() + within_s, None
        while (now_s := time.monotonic()) < deadline and (found_s is None or now_s < found_s + 0.5):
            with suppress(OSError):
                self.seen += os.read(self.master, 65536)
            found_s = found_s or (now_s if text in self.seen else None)
            time.sleep(0.02)
        assert found_s is not None, self.seen
        seen, self.seen = self.seen, b""
        return seen

    def type(self, text: str) -> None:
        """Type a line."""
        os.write(self.master, text.encode() + b"\n")


@pytest.mark.parametrize("number", [pytest.param(signal.SIGINT, marks=pytest.mark.slow), signal.SIGTERM])
def test_an_operator_sees_the_question_and_can_end_it(tmp_path: Path, number: signal.Signals) -> None:
    profile = profile_from_dict(tiny(**SHORT), "short.toml")
    with serving(profile, {"gyro": "kvh-dsp3000"}) as served:
        lines = {**wired(profile, served).raw, "table": {"device": "manual"}}
        path = tmp_path / "wired.toml"
        path.write_text(toml(json.loads(json.dumps(lines))))
        terminal = Terminal(
            sys.executable, "-m", "gyrocal", "acquire", str(path), "--out", str(tmp_path / "r")
        )
        with terminal.process as process:
            question = b"Make sure that the table stands, then type its rate in deg/s (0):"
            after = terminal.read(question).partition(question)[2]
            assert after.strip() == b"", "drawn over"
            terminal.type("0")
            terminal.read(b"Set the table to +0 deg/s")
            process.send_signal(number)
            terminal.read(b"STOP THE TABLE NOW")
            terminal.type("0")
            said = terminal.read(b"what was sealed is kept")
            assert process.wait(60.0) == 130, said
        os.close(terminal.master)
    (line,) = events(tmp_path / "r", "make_safe")
    assert line["table_stopped"] is True


def with_lines(profile: Profile, lines: list[str], path: Path) -> Path:
    """The profile with the lines of `gyrocal sim` in the place of its own."""
    own = {k: v for k, v in profile.raw.items() if k not in ("gyro", "table", "chamber")}
    path.write_text(toml(json.loads(json.dumps(own))) + "\n" + "".join(lines))
    return path


def test_sim_prints_a_profile_that_works(tmp_path: Path) -> None:
    with sim("--profile", "quick", "--links", str(tmp_path / "ports")) as lines:
        assert any(line.startswith('device = "kvh-frame-a:') for line in lines)
        port = SerialTransport(str(tmp_path / "ports" / "gyro"), 921600)
        deadline = time.monotonic() + 60.0
        data = b""
        while len(data) < 36 * 3 and time.monotonic() < deadline:
            data += port.read_available(0.5)
        port.close()
        assert bytes.fromhex("FE81FF55") in data
    assert not (tmp_path / "ports" / "gyro").is_symlink()


def test_a_burst_on_a_pseudo_terminal_is_not_lost_and_what_nobody_reads_is(tmp_path: Path) -> None:
    endpoint = PtyEndpoint(tmp_path / "port")
    port = SerialTransport(endpoint.address, 921600)
    burst = bytes(range(256)) * 400
    endpoint.write(burst)
    data = b""
    while len(data) < len(burst):
        data += port.read_available(1.0)
        endpoint.write(b"")
    assert data == burst
    for _ in range(2000):
        endpoint.write(b"x" * 1000)
    data = b""
    while chunk := port.read_available(0.1):
        data += chunk
        endpoint.write(b"")
    assert 0 < len(data) < 600_000
    port.close()
    endpoint.close()


def test_a_run_is_carried_on_at_other_ports(tmp_path: Path) -> None:
    profile = profile_from_dict(tiny(**SHORT), "short.toml")
    for resume in (False, True):
        requests = StopRequests()

        class Impatient(Silent):
            def progress(self, progress: Progress, requests: StopRequests = requests) -> None:
                requests.ask(1, "the test")

        with serving(profile, {"gyro": "kvh-dsp3000"}) as served:
            path = profile_file(wired(profile, served), tmp_path / "wired.toml")
            with pytest.raises(InterruptedRunError):
                acquire(AcquireConfig(path, tmp_path / "r", resume=resume), Impatient(), requests)
    (line,) = events(tmp_path / "r", "resume")
    assert line["ports"]["gyro.device"] == f"kvh-dsp3000:{served.addresses['gyro']}"
    assert set(line["ports"]) == {"gyro.device", "table.device", "chamber.device"}


def test_links_left_by_a_sim_that_was_killed_are_taken_and_others_refused(tmp_path: Path) -> None:
    (tmp_path / "gyro").symlink_to("/dev/pts/none")
    endpoint = PtyEndpoint(tmp_path / "gyro")
    with pytest.raises(OutputError, match=r"gyro: is there already\. End the gyrocal sim"):
        PtyEndpoint(tmp_path / "gyro")
    endpoint.close()
