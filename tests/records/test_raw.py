"""Raw captures: what was written is read back; damage is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from gyrocal.errors import InputError, OutputError
from gyrocal.records.raw import RawWriter, iterate_raw, read_raw_head


def capture(path: Path) -> None:
    writer = RawWriter(path, "kvh-dsp3000", {"baud": 38400})
    writer.chunk(0.25, b"\x00\xff")
    writer.chunk(0.5, b"abc")
    writer.close()


def test_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "gyro.raw"
    capture(path)
    assert read_raw_head(path)["device"] == "kvh-dsp3000"
    assert list(iterate_raw(path)) == [(0.25, b"\x00\xff"), (0.5, b"abc")]


def test_an_existing_capture_is_not_overwritten(tmp_path: Path) -> None:
    capture(tmp_path / "gyro.raw")
    with pytest.raises(OutputError):
        capture(tmp_path / "gyro.raw")


def test_a_line_cut_off_by_a_crash_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "gyro.raw"
    capture(path)
    path.write_text(path.read_text() + "0.75 616")
    assert len(list(iterate_raw(path))) == 2


@pytest.mark.parametrize("text", ["", "t_s,gyro_dps\n", '{"schema": "gyrocal-raw/2"}\n'])
def test_another_file_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "other"
    path.write_text(text)
    with pytest.raises(InputError, match="is not a raw capture"):
        list(iterate_raw(path))


def test_a_damaged_line_is_named(tmp_path: Path) -> None:
    path = tmp_path / "gyro.raw"
    capture(path)
    path.write_text(path.read_text().replace("616263", "61626z"))
    with pytest.raises(InputError, match="line 3: is not a time and bytes"):
        list(iterate_raw(path))
