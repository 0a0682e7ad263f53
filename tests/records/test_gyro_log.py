"""Logs of autopilots, written here byte by byte from the formats' descriptions, read by the libraries."""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gyrocal.errors import InputError
from gyrocal.records.gyro_log import GyroChoice, iterate_gyro_log
from tests.records.test_drive_bags import write_bag

T_S = 0.004 * np.arange(2000)
RATES = np.stack([np.sin(T_S), 2.0 + 0.0 * T_S, -0.01 * T_S], axis=1)
TEMP_C = 20.0 + T_S


def ulog(path: Path, topic: str = "sensor_gyro") -> Path:
    """ULog 1: header, format, subscription, data (docs.px4.io, "ULog file format")."""

    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), kind[0]) + body

    fields = {
        "sensor_gyro": "uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;float temperature;",
        "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;",
    }[topic]
    data = bytearray(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0))
    data += message(b"B", bytes(40)) + message(b"F", f"{topic}:{fields}".encode())
    data += message(b"A", struct.pack("<BH", 0, 7) + topic.encode())
    for t, rate, temp in zip(T_S, RATES, TEMP_C, strict=True):
        stamp = struct.pack("<Q", round(1e6 * t))
        body = stamp + stamp + struct.pack("<4f", *rate, temp)
        if topic == "sensor_combined":
            body = stamp + struct.pack("<3f", *rate)
        data += message(b"D", struct.pack("<H", 7) + body)
    path.write_bytes(data)
    return path


def dataflash(path: Path, raw: bool = False) -> Path:
    """ArduPilot's DataFlash: FMT messages that describe the others, then IMU of two gyros in turn; `raw`: each fourth, and GYR."""
    head = b"\xa3\x95"

    def described(kind: int, length: int, name: bytes, form: bytes, columns: bytes) -> bytes:
        return head + struct.pack("<BBB4s16s64s", 128, kind, length, name, form, columns)

    data = bytearray(described(128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns"))
    data += described(130, 3 + 8 + 1 + 16, b"IMU", b"QBffff", b"TimeUS,I,GyrX,GyrY,GyrZ,T")
    data += described(131, 3 + 8 + 1 + 8 + 12, b"GYR", b"QBQfff", b"TimeUS,I,SampleUS,GyrX,GyrY,GyrZ")
    for k, (t, rate, temp) in enumerate(zip(T_S, RATES, TEMP_C, strict=True)):
        for instance, sign in ((0, 1.0), (1, -1.0)):
            if raw and instance == 0:
                us = round(1e6 * t)
                data += head + bytes([131]) + struct.pack("<QBQfff", us + 7000, instance, us, *rate)
            if raw and k % 4:
                continue
            row = struct.pack("<QBffff", round(1e6 * t) + 1000, instance, *(sign * rate), temp)
            data += head + bytes([130]) + row
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("axis", ["x", "y", "-z"])
@pytest.mark.parametrize("topic", ["sensor_gyro", "sensor_combined"])
def test_a_log_of_px4(tmp_path: Path, axis: str, topic: str) -> None:
    pytest.importorskip("pyulog")
    (block,) = iterate_gyro_log(ulog(tmp_path / "a.ulg", topic), GyroChoice(axis))
    sign = -1.0 if axis.startswith("-") else 1.0
    np.testing.assert_allclose(block.t_s, T_S, atol=1e-9)
    np.testing.assert_allclose(
        block.gyro_dps, sign * np.degrees(RATES[:, "xyz".index(axis[-1])]), rtol=1e-6, atol=1e-7
    )
    expected = TEMP_C if topic == "sensor_gyro" else np.full(T_S.size, np.nan)
    np.testing.assert_allclose(block.temp_c, expected, rtol=1e-6)
    assert block.usual_dt_s == pytest.approx(0.004)


@pytest.mark.parametrize(
    ("library", "name", "make"), [("pyulog", "a.ulg", ulog), ("pymavlink", "a.bin", dataflash)]
)
def test_damage_that_the_parser_passes_over_is_said_once(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], library: str, name: str, make: Callable[[Path], Path]
) -> None:
    pytest.importorskip(library)
    path = make(tmp_path / name)
    sound = path.read_bytes()
    path.write_bytes(sound[:20_000] + bytes(40) + sound[20_040:])
    blocks = list(iterate_gyro_log(path))
    assert sum(map(len, blocks)) < T_S.size
    assert blocks[0].notes[0].startswith("read: ")
    assert blocks[0].notes[1:] == ("parts of the file are damaged and left out",)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("instance", [0, 1])
def test_a_log_of_ardupilot(tmp_path: Path, instance: int) -> None:
    pytest.importorskip("pymavlink")
    (block,) = iterate_gyro_log(dataflash(tmp_path / "a.BIN"), GyroChoice("x", instance))
    sign = 1.0 - 2.0 * instance
    np.testing.assert_allclose(block.t_s, T_S + 1e-3, atol=1e-9)
    np.testing.assert_allclose(block.gyro_dps, sign * np.degrees(RATES[:, 0]), rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(block.temp_c, TEMP_C, rtol=1e-6)


def test_raw_samples_of_ardupilot_are_taken_before_filtered_ones(tmp_path: Path) -> None:
    """With the sensor's own times, and the temperature that the filtered ones have."""
    pytest.importorskip("pymavlink")
    path = dataflash(tmp_path / "a.bin", raw=True)
    (block,) = iterate_gyro_log(path, GyroChoice("x"))
    assert block.notes == ("read: GYR messages of gyro 0, axis x",)
    np.testing.assert_allclose(block.t_s, T_S, atol=1e-9)
    np.testing.assert_allclose(block.gyro_dps, np.degrees(RATES[:, 0]), rtol=1e-6, atol=1e-7)
    assert np.nanmax(np.abs(block.temp_c - TEMP_C)) < 0.02
    (other,) = iterate_gyro_log(path, GyroChoice("x", 1))
    assert other.notes == ("read: IMU messages of gyro 1, axis x",)
    assert len(other) == T_S.size // 4


@pytest.mark.parametrize(
    ("library", "name", "make"), [("pyulog", "a.ulg", ulog), ("pymavlink", "a.bin", dataflash)]
)
def test_a_gyro_that_is_not_there_is_told(tmp_path: Path, library: str, name: str, make: object) -> None:
    pytest.importorskip(library)
    make(tmp_path / name)  # type: ignore[operator]
    with pytest.raises(InputError, match=r"holds no gyro 5 \(found: .*0.*\). Choose another instance."):
        list(iterate_gyro_log(tmp_path / name, GyroChoice(instance=5)))


@pytest.mark.parametrize("name", ["a.ulg", "a.bin"])
def test_what_is_no_log_is_refused(tmp_path: Path, name: str) -> None:
    pytest.importorskip("pyulog")
    pytest.importorskip("pymavlink")
    with pytest.raises(InputError, match="no such file"):
        list(iterate_gyro_log(tmp_path / name))
    (tmp_path / name).write_bytes(b"nothing of the kind" * 100)
    with pytest.raises(InputError):
        list(iterate_gyro_log(tmp_path / name))


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_a_ros_bag(tmp_path: Path, kind: str) -> None:
    topics = {"/a": "sensor_msgs/msg/Imu", "/odom": "nav_msgs/msg/Odometry"}
    path = write_bag(tmp_path / ("still.bag" if kind == "bag" else "still"), kind, topics)
    blocks = list(iterate_gyro_log(path))
    t_s = np.concatenate([block.t_s for block in blocks])
    assert t_s.size == 150
    np.testing.assert_allclose(np.diff(t_s), 0.02, atol=1e-6)
    turned = np.concatenate([block.gyro_dps for block in iterate_gyro_log(path, GyroChoice("-z"))])
    np.testing.assert_allclose(turned, -np.concatenate([block.gyro_dps for block in blocks]))
    with pytest.raises(InputError, match="topic '/odom' cannot be imu"):
        next(iterate_gyro_log(path, GyroChoice(topic="/odom")))


def test_a_bag_with_two_imus_is_asked_which(tmp_path: Path) -> None:
    imu = "sensor_msgs/msg/Imu"
    path = write_bag(tmp_path / "two.bag", "bag", {"/a": imu, "/b": imu})
    with pytest.raises(InputError, match=r"several \(/a, /b\).*--topic imu=TOPIC"):
        next(iterate_gyro_log(path))
    assert next(iterate_gyro_log(path, GyroChoice(topic="/b"))).t_s.size == 150


def test_a_csv_has_one_gyro(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t_s,gyro_dps\n0,1\n1,2\n")
    assert sum(map(len, iterate_gyro_log(path))) == 2
    with pytest.raises(InputError, match="is a CSV, and axis and instance are of an autopilot's log"):
        iterate_gyro_log(path, GyroChoice("x"))


MAP = """[columns.t_s]
from = "stamp"
unit = "ms"
[columns.gyro_dps]
from = "gz"
unit = "rad/s"
sign = -1
"""
WARM = """[columns.gyro_temp_c]
from = "temp"
unit = "K"
"""


@pytest.mark.parametrize("warm", ["", WARM])
def test_a_csv_of_others_is_mapped(tmp_path: Path, warm: str) -> None:
    (tmp_path / "map.toml").write_text(MAP + warm)
    path = tmp_path / "a.csv"
    path.write_text("stamp,name,gz,temp\n0,a,0.5,300\n10,b,,300\n20,c,-0.5,301\n")
    (block,) = iterate_gyro_log(path, GyroChoice(columns=tmp_path / "map.toml"))
    np.testing.assert_allclose(block.t_s, [0.0, 0.01, 0.02])
    np.testing.assert_allclose(block.gyro_dps, np.degrees([-0.5, np.nan, 0.5]))
    np.testing.assert_allclose(block.temp_c, [26.85, 26.85, 27.85] if warm else [np.nan] * 3)
    with pytest.raises(InputError, match="mapped with --columns"):
        list(iterate_gyro_log(path))


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        (MAP.partition("[columns.gyro_dps]")[0], "a.csv", r"\[columns.gyro_dps\] is missing; required: t_s, gyro_dps\."),
        (MAP.replace("gz", "gw"), "a.csv", "column 'gw', mapped to gyro_dps, is missing"),
        (MAP + WARM + 'file = "b.csv"\n', "a.csv", "mapped to another file"),
        (MAP, "a.ulg", "is no CSV, and columns are mapped of one"),
    ],
)  # fmt: skip
def test_a_mapping_that_cannot_be_followed_is_refused(
    tmp_path: Path, text: str, name: str, message: str
) -> None:
    (tmp_path / "map.toml").write_text(text)
    (tmp_path / name).write_text("stamp,gz\n0,0.5\n10,0.5\n")
    with pytest.raises(InputError, match=message):
        list(iterate_gyro_log(tmp_path / name, GyroChoice(columns=tmp_path / "map.toml")))


def test_telemetry_is_refused_with_what_to_take(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is telemetry of a ground station.*\.bin of ArduPilot"):
        iterate_gyro_log(tmp_path / "a.tlog")


@pytest.mark.parametrize(
    ("module", "name", "extra"), [("pyulog", "a.ulg", "px4"), ("pymavlink.DFReader", "a.bin", "ardupilot")]
)
def test_without_the_extra_one_sentence_says_how_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, name: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / name).write_bytes(b"x")
    with pytest.raises(InputError, match=rf"install it with: pip install 'gyrocal\[{extra}\]'"):
        list(iterate_gyro_log(tmp_path / name))
