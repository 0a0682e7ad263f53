"""Gyro codecs: the vectors of protocols.md, and streams that are split, cut, flipped and repeated."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrocal.bench.gyros import ascii_line, dsp3000, ecore2000, kvh_frame, vn100
from gyrocal.bench.gyros.codec import Decoder, Frame
from gyrocal.bench.registry import GYROS
from gyrocal.errors import ProfileError

KVH = kvh_frame.Options()
ECORE = ecore2000.Options(lsb_dps=0.00183)
ASCII = ascii_line.Options(columns=("rate", "temp", "status", "sequence"), sequence_modulus=256)

MakeDecoder = Callable[[], Decoder]
EncodeNumber = Callable[[int], bytes]

#: name -> decoder, and a message whose rate tells which one it is.
DEVICES: dict[str, tuple[MakeDecoder, EncodeNumber]] = {
    "ecore2000": (lambda: ecore2000.ECore2000Decoder(ECORE), lambda i: ecore2000.encode(10 * i)),
    "dsp3000": (dsp3000.Dsp3000Decoder, lambda i: dsp3000.encode(0.125 * i)),
    "kvh_a": (
        lambda: kvh_frame.KvhFrameDecoder(KVH),
        lambda i: kvh_frame.encode(0.125 * i, 20.0 + i, i, KVH),
    ),
    "kvh_b": (
        lambda: kvh_frame.KvhFrameDecoder(KVH),
        lambda i: kvh_frame.encode(0.125 * i, 20.0 + i, i, KVH, time_us=1000 * i),
    ),
    "vn100": (vn100.Vn100Decoder, lambda i: vn100.encode(0.125 * i, 20.0 + i)),
    "ascii_line": (
        lambda: ascii_line.AsciiLineDecoder(ASCII),
        lambda i: ascii_line.encode(ASCII, rate=0.125 * i, temp=20.0 + i, status=0, sequence=i),
    ),
}
LINES = ("dsp3000", "vn100", "ascii_line")
CHECKED = ("ecore2000", "kvh_a", "kvh_b", "vn100")

devices = pytest.mark.parametrize("device", DEVICES)


def stream(device: str, count: int = 8) -> bytes:
    """Messages 1..count; line devices get a line end first, since the first line is never trusted."""
    encode = DEVICES[device][1]
    return (b"\r\n" if device in LINES else b"") + b"".join(encode(i) for i in range(1, count + 1))


def decode(device: str, data: bytes) -> list[Frame]:
    return DEVICES[device][0]().feed(data)


@pytest.mark.parametrize(
    ("counts", "wire"),
    [
        (0, "F6 04 46 45 33 60 00 00"),
        (1, "F5 44 46 45 33 60 00 01"),
        (-1, "F7 04 46 45 33 63 7F 7F"),
        (5464, "BF 44 46 45 33 60 2A 58"),
        (-16392, "9A 44 46 45 33 62 7F 78"),
    ],
)
def test_ecore_vectors(counts: int, wire: str) -> None:
    assert ecore2000.encode(counts) == bytes.fromhex(wire)
    (frame,) = ecore2000.ECore2000Decoder(ECORE).feed(bytes.fromhex(wire))
    assert frame.rate_dps == pytest.approx(counts * 0.00183)
    assert math.isnan(frame.temp_c)


def test_ecore_sign_is_an_option() -> None:
    options = ecore2000.Options(0.00183, counter_clockwise_positive=False)
    (frame,) = ecore2000.ECore2000Decoder(options).feed(ecore2000.encode(100))
    assert frame.rate_dps == pytest.approx(-0.183)


def test_ecore_temperature_byte_is_an_option() -> None:
    options = ecore2000.Options(0.00183, temperature_byte=2, temperature_lsb_c=0.5, temperature_zero_c=-40.0)
    (frame,) = ecore2000.ECore2000Decoder(options).feed(GYROS["kvh-ecore2000"].encode(9.15, 21.5, 0, options))
    assert frame.temp_c == 21.5
    assert frame.rate_dps == pytest.approx(9.15)
    (frame,) = ecore2000.ECore2000Decoder(ecore2000.Options(0.00183)).feed(frame.raw)
    assert math.isnan(frame.temp_c)


def test_ecore_refuses_what_does_not_fit() -> None:
    with pytest.raises(ValueError, match="do not fit"):
        ecore2000.encode(40000)
    with pytest.raises(ValueError, match="four bytes"):
        ecore2000.encode(0, b"123")


def test_kvh_manual_sample() -> None:
    wire = bytes.fromhex("FE81FF5537A96A6E38586C1FB75BF862BF803E78BB650D283B0A37AC773D00284BFA34D8")
    options = kvh_frame.Options(axis="x", data_rate_hz=1.0, rotation_is_delta=True, temperature_lsb_c=1.0)
    (frame,) = kvh_frame.KvhFrameDecoder(options).feed(wire)
    assert math.radians(frame.rate_dps) == pytest.approx(2.0196e-05, rel=1e-4)
    assert (frame.temp_c, frame.sequence, frame.status) == (40.0, 61, 0)


def test_kvh_crc_catalogue_value() -> None:
    assert kvh_frame.crc32_mpeg2(b"123456789") == 0x0376E6E7


@pytest.mark.parametrize("wire", ["FE8100AA" + "7F" * 6 + "23", "FE8100AB" + "7F" * 6 + "377FDA"])
def test_kvh_bit_answer_inside_the_stream_is_stepped_over(wire: str) -> None:
    answer = bytes.fromhex(wire)
    decoder = kvh_frame.KvhFrameDecoder(KVH)
    data = kvh_frame.encode(1.0, 20.0, 1, KVH) + answer + kvh_frame.encode(2.0, 20.0, 2, KVH)
    assert [f.sequence for f in decoder.feed(data)] == [1, 2]
    assert decoder.health().frames_bad == 0
    assert decoder.health().bytes_skipped == len(answer)


def test_kvh_sequence_gaps_and_status_are_counted() -> None:
    decoder = kvh_frame.KvhFrameDecoder(KVH)
    frames = decoder.feed(
        b"".join(kvh_frame.encode(0.0, 20.0, i, KVH, valid=i != 127) for i in (126, 127, 0, 3))
    )
    assert [f.status == 0 for f in frames] == [True, False, True, True]
    assert (decoder.health().sequence_gaps, decoder.health().status_bad) == (1, 1)


def test_dsp3000_line_of_the_drivers() -> None:
    line = b"       0.015733   1\r\n"
    assert dsp3000.encode(-0.015733) == line
    (frame,) = decode("dsp3000", b"\r\n" + line)
    assert frame.rate_dps == -0.015733


def test_dsp3000_refuses_a_cut_number_and_flags_fault_and_over_range() -> None:
    decoder = dsp3000.Dsp3000Decoder()
    frames = decoder.feed(b"\r\n0.015733   1\r\n" + dsp3000.encode(1.0, valid=False) + dsp3000.encode(-400.0))
    assert [f.status for f in frames] == [dsp3000.STATUS_FAULT, dsp3000.STATUS_OVER_RANGE]
    assert decoder.health().frames_bad == 1
    with pytest.raises(ValueError, match="does not fit"):
        dsp3000.encode(1000.0)


def test_vn100_vector_and_crc() -> None:
    body = "$VNIMU,-00.0350,+00.4222,-00.6643,-00.015,+00.019,+09.948,+00.002066,-00.008442,-00.044656,+20.7,+084.322*66"
    (frame,) = decode("vn100", f"\r\n{body}\r\n".encode())
    assert math.radians(frame.rate_dps) == pytest.approx(-0.044656)
    assert frame.temp_c == 20.7
    assert vn100.crc16(b"123456789") == 0x31C3
    with_crc = body[:-2] + f"{vn100.crc16(body[1:-3].encode()):04X}"
    assert len(decode("vn100", f"\r\n{with_crc}\r\n".encode())) == 1
    assert vn100.command("VNRRG,01") == b"$VNRRG,01*72\r\n"
    with pytest.raises(ValueError, match="finite"):
        vn100.encode(math.nan, 20.0)


def test_ascii_line_by_pattern_with_units() -> None:
    options = ascii_line.Options(pattern=r"w=(?P<rate>[-+.\deE]+) T=(?P<temp>[-+.\d]+)", rate_unit="rad/s")
    (frame,) = ascii_line.AsciiLineDecoder(options).feed(b"\nw=0.1 T=21.5\r\nw=oops T=1\n")
    assert frame.rate_dps == pytest.approx(math.degrees(0.1))
    assert frame.temp_c == 21.5


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (ascii_line.Options(columns=("temp",)), "gyro.options.columns must name rate once"),
        (ascii_line.Options(columns=("rate", "temp", "temp")), "temp, status, sequence none twice"),
        (ascii_line.Options(rate_scale=0.0), "gyro.options.rate_scale is 0"),
        (ascii_line.Options(pattern="("), "gyro.options.pattern is not a regular expression"),
        (ascii_line.Options(pattern="(.*)"), "gyro.options.pattern has no group named rate"),
    ],
)
def test_ascii_line_refuses_a_bad_description(options: ascii_line.Options, text: str) -> None:
    with pytest.raises(ProfileError) as refusal:
        ascii_line.AsciiLineDecoder(options)
    assert text in str(refusal.value)


@devices
def test_round_trip(device: str) -> None:
    frames = decode(device, stream(device))
    step = 0.0183 if device == "ecore2000" else 0.125
    assert [f.rate_dps for f in frames] == pytest.approx([step * i for i in range(1, 9)], abs=1e-4)


@devices
@given(cuts=st.lists(st.integers(0, 400), max_size=12))
def test_splitting_the_stream_changes_nothing(device: str, cuts: list[int]) -> None:
    data = stream(device)
    decoder = DEVICES[device][0]()
    edges = [0, *sorted(min(c, len(data)) for c in cuts), len(data)]
    frames = [f for a, b in itertools.pairwise(edges) for f in decoder.feed(data[a:b])]
    assert [f.raw for f in frames] == [f.raw for f in decode(device, data)]
    assert decoder.health().bytes_in == len(data)


@devices
@given(data=st.binary(max_size=600))
def test_any_bytes_never_raise_and_sync_is_found_again(device: str, data: bytes) -> None:
    decoder = DEVICES[device][0]()
    decoder.feed(data)
    # A header or line begun by the noise may swallow what follows it, but never more than a few messages.
    frames = decoder.feed(stream(device, 60))
    true_frames = {f.raw for f in decode(device, stream(device, 60))}
    assert len([f for f in frames if f.raw in true_frames]) >= 60 - 16


@pytest.mark.parametrize("device", CHECKED)
@given(place=st.integers(0, 10_000), bit=st.integers(0, 7))
def test_a_flipped_bit_is_never_accepted(device: str, place: int, bit: int) -> None:
    data = bytearray(stream(device))
    data[place % len(data)] ^= 1 << bit
    true_frames = {f.raw for f in decode(device, stream(device))}
    assert {f.raw for f in decode(device, bytes(data))} <= true_frames | _case_changed(device, bytes(data))


def _case_changed(device: str, data: bytes) -> set[bytes]:
    """VN-100: flipping the case of a check digit gives another spelling of the same, valid message."""
    if device != "vn100":
        return set()
    return {line for line in data.split(b"\r\n") if line.upper() in stream(device)}


@pytest.mark.parametrize("device", CHECKED)
@given(begin=st.integers(0, 400), length=st.integers(1, 60))
def test_dropped_bytes_never_make_a_wrong_frame(device: str, begin: int, length: int) -> None:
    data = stream(device)
    begin %= len(data)
    true_frames = {f.raw for f in decode(device, data)}
    assert {f.raw for f in decode(device, data[:begin] + data[begin + length :])} <= true_frames


@devices
def test_a_repeated_message_is_seen_where_the_device_counts(device: str) -> None:
    one = DEVICES[device][1](5)
    decoder = DEVICES[device][0]()
    decoder.feed((b"\r\n" if device in LINES else b"") + one + one)
    counts = device in ("kvh_a", "kvh_b", "ascii_line")
    assert decoder.health().frames_good == (1 if counts else 2)
    assert decoder.health().frames_bad == int(counts)


def test_a_line_without_end_is_dropped_with_its_rest() -> None:
    decoder = vn100.Vn100Decoder()
    decoder.feed(b"\n" + b"\x80" * 1000)
    assert decoder.health().frames_bad >= 1
    assert [len(decoder.feed(stream("vn100")))] == [8]
