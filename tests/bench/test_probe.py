"""What is on a port: nothing, bytes but no frame, frames of which kind."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import pytest
from click.testing import CliRunner

from gyrocal.bench.capture import decode_capture
from gyrocal.bench.clock import RealClock
from gyrocal.bench.gyros import ascii_line, ecore2000, kvh_frame, vn100
from gyrocal.bench.probe import identify, probe_port
from gyrocal.bench.registry import GYROS
from gyrocal.bench.virtual.endpoints import TcpEndpoint
from gyrocal.cli import gyrocal_command
from gyrocal.errors import DeviceError, InputError
from gyrocal.records.raw import RawWriter

OPTIONS: dict[str, object] = {
    "kvh-ecore2000": ecore2000.Options(lsb_dps=0.00183),
    "ascii-line": ascii_line.Options(columns=("rate", "temp")),
}


def sent(kind: str, count: int = 50) -> bytes:
    gyro = GYROS[kind]
    options = OPTIONS.get(kind) or gyro.options()
    return b"\r\n" + b"".join(gyro.encode(0.5 * i, 20.0, i, options) for i in range(count))


@pytest.mark.parametrize("path", ["/dev/null", "/"])
def test_what_is_no_port_is_told_with_what_to_give(path: str) -> None:
    with pytest.raises(DeviceError, match=r"is no serial port\. Give a device .* or a URL"):
        probe_port(path, None, RealClock(), 0.1)


@pytest.mark.parametrize("kind", GYROS)
def test_every_gyro_is_known_by_its_frames(kind: str) -> None:
    data = sent(kind)
    part = len(data) // 40 + 1
    chunks = [(0.05 * i, data[i * part : (i + 1) * part]) for i in range(40)]
    finding = identify(chunks, 2.0, 115200)
    assert finding.kind == kind
    assert finding.rate_hz == pytest.approx(25.0, abs=1.0)
    assert finding.has_temperature == (GYROS[kind].has_temperature and kind != "ascii-line")
    assert finding.verdict.startswith(f"{kind}: 2")


def test_nothing_and_unknown_bytes_are_told_apart() -> None:
    assert identify([], 2.0, 9600).verdict.startswith("Nothing: no byte came in 2 s.")
    verdict = identify([(0.0, b"\x00\xc3" * 100)], 2.0, 9600).verdict
    assert "200 bytes came in 2 s at 9600 baud, and no known frame" in verdict
    assert "00 c3 00" in verdict


def test_a_vn100_in_its_power_up_mode_is_known() -> None:
    data = b"".join(vn100.command(f"VNYMR,+{i:03d}.000,-1.0") for i in range(20))
    finding = identify([(0.1, data)], 2.0, 115200)
    assert finding.kind == "vn100"
    assert finding.verdict == "vn100: sends VNYMR, 10.0 a second; acquire selects VNIMU by itself."


def test_what_had_waited_in_a_buffer_does_not_count_for_the_rate() -> None:
    options = kvh_frame.Options()
    frames = [kvh_frame.encode(0.0, 20.0, i, options) for i in range(600)]
    chunks = [(0.01, b"".join(frames[:400])), *((0.01 * i, frames[400 + i]) for i in range(1, 200))]
    assert identify(chunks, 2.0, 921600).rate_hz == pytest.approx(100.0, rel=0.02)


def test_status_is_told() -> None:
    options = kvh_frame.Options()
    data = b"".join(kvh_frame.encode(0.0, 20.0, i, options, valid=i > 3) for i in range(20))
    finding = identify([(0.0, data)], 1.0, 921600)
    assert finding.status_bad == 4
    assert "calls 4 of 20 bad" in finding.verdict


def test_probe_of_a_tcp_port_that_streams_and_of_one_that_is_silent() -> None:
    endpoint, stop = TcpEndpoint(), threading.Event()

    def stream() -> None:
        while not stop.wait(0.01):
            endpoint.read()
            endpoint.write(sent("kvh-frame-a", 10)[2:])

    thread = threading.Thread(target=stream)
    thread.start()
    try:
        result = CliRunner().invoke(
            gyrocal_command, ["probe", endpoint.address, "--seconds", "0.3", "--json"]
        )
    finally:
        stop.set()
        thread.join()
    assert json.loads(result.output)["kind"] == "kvh-frame-a"
    assert result.exit_code == 0
    result = CliRunner().invoke(gyrocal_command, ["probe", endpoint.address, "--seconds", "0.1"])
    endpoint.close()
    assert result.exit_code == 9
    assert result.output.startswith("Nothing: no byte came")


def test_a_capture_is_decoded_by_the_codec_that_recorded_it(tmp_path: Path) -> None:
    path, out = tmp_path / "run" / "raw" / "gyro.raw", tmp_path / "samples.csv"
    path.parent.mkdir(parents=True)
    (tmp_path / "run" / "run.json").write_text("{}")
    writer = RawWriter(path, "kvh-frame-a", {"axis": "z", "temperature_lsb_c": 0.01})
    data = sent("kvh-frame-a", 20)
    for i in range(0, len(data), 50):
        writer.chunk(0.01 * i, data[i : i + 50])
    writer.close()
    result = CliRunner().invoke(gyrocal_command, ["decode", str(path), "-o", str(out)])
    assert result.exit_code == 0
    assert result.output.startswith("kvh-frame-a: 20 frames in 7.0 s, 0 damaged, 2 of 722 bytes skipped")
    lines = out.read_text().splitlines()
    assert lines[0] == "t_s,gyro_dps,gyro_temp_c,status,sequence"
    assert lines[1:3] == ["0.000000,0.0000000,20.000,0,0", "0.500000,0.5000000,20.000,0,1"]
    assert len(lines) == 21
    captured = path.read_bytes()
    for target, more, said in (
        (out, [], "exists; nothing was overwritten"),
        (path, ["--overwrite"], "is an input of this command"),
        (tmp_path / "run" / "run.json", ["--overwrite"], "or lies in it"),
    ):
        refused = CliRunner().invoke(gyrocal_command, ["decode", str(path), "-o", str(target), *more])
        assert said in str(refused.exception)
    assert path.read_bytes() == captured
    again = CliRunner().invoke(gyrocal_command, ["decode", str(path), "-o", str(out), "--overwrite"])
    assert again.output == result.output


def test_a_capture_of_no_gyro_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "table.raw"
    RawWriter(path, "zaber", {}).close()
    with pytest.raises(InputError, match="is of 'zaber', and only gyros are decoded"):
        decode_capture(path, tmp_path / "out.csv")
    assert not (tmp_path / "out.csv").exists()
