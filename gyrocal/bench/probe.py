"""What is on a port: nothing, bytes but no frame, or frames of which kind, how often, with or without temperature."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, asdict, dataclass, fields
from typing import Any

from gyrocal.bench.clock import Clock
from gyrocal.bench.gyros import ascii_line, dsp3000, ecore2000, kvh_frame, vn100
from gyrocal.bench.gyros.codec import Decoder, Frame
from gyrocal.bench.registry import GYROS, OWN_GYROS
from gyrocal.bench.transport import SerialTransport, Transport

#: A kind is believed when at least so many frames decode and no more than this share of the bytes is left over.
_MIN_FRAMES = 5
_MAX_LEFT_OVER = 0.2
#: Bytes of this first part of the time of listening may be old.
_STALE_SHARE = 0.05


def _candidates() -> dict[str, Decoder]:
    """A decoder for each kind; scales that the wire does not tell are 1, since only the frames are looked at."""
    return {
        "kvh-frame-a": kvh_frame.KvhFrameDecoder(kvh_frame.Options()),
        "kvh-frame-b": kvh_frame.KvhFrameDecoder(kvh_frame.Options()),
        "vn100": vn100.Vn100Decoder(),
        "kvh-dsp3000": dsp3000.Dsp3000Decoder(),
        "kvh-ecore2000": ecore2000.ECore2000Decoder(ecore2000.Options(lsb_dps=1.0)),
        **_added(),
        # Last: any line that begins with a number is one of these.
        "ascii-line": ascii_line.AsciiLineDecoder(
            ascii_line.Options(pattern=r"(?P<rate>[-+]?\d+\.?\d*)\b.*")
        ),
    }


def _added() -> dict[str, Decoder]:
    """Decoders of the gyros that other packages add, where their options can all be left out."""
    kinds = {name: GYROS[name] for name in GYROS.keys() - OWN_GYROS}
    needed = {n for n, k in kinds.items() if any(_must_be_given(f) for f in fields(k.options))}
    return {name: kinds[name].decoder(kinds[name].options()) for name in sorted(kinds.keys() - needed)}


def _must_be_given(option: Field[Any]) -> bool:
    return option.init and option.default is MISSING and option.default_factory is MISSING


@dataclass(frozen=True)
class Finding:
    """What was found.

    Attributes
    ----------
    kind : str or None
        Name of the device as a profile writes it; None: nothing, or nothing known.
    verdict : str
        One sentence for the operator.
    bytes_in, frames, status_bad : int
        Counters of the listening time.
    rate_hz : float
        Frames a second; NaN where there are none.
    has_temperature : bool
        Whether the frames carry one.
    """

    kind: str | None
    verdict: str
    bytes_in: int
    frames: int
    status_bad: int
    rate_hz: float
    has_temperature: bool

    def to_json(self) -> Mapping[str, Any]:
        """Plain data; NaN becomes null."""
        return asdict(self) | {"rate_hz": None if math.isnan(self.rate_hz) else self.rate_hz}


def probe_port(url: str, baud: int | None, clock: Clock, duration_s: float) -> Finding:
    """Listen on a port at `baud`, or at the usual speeds in turn until something is known.

    Raises
    ------
    DeviceError
        The port cannot be opened, or goes while it is listened to.
    """
    # A socket has no speed of its own to try.
    speeds = (
        [baud]
        if baud
        else [115200]
        if "://" in url
        else sorted({k.baud for k in GYROS.values()}, reverse=True)
    )
    best: Finding | None = None
    for speed in speeds:
        transport = SerialTransport(url, speed)
        try:
            finding = identify(listen(transport, clock, duration_s), duration_s, speed)
        finally:
            transport.close()
        if finding.kind is not None:
            return finding
        if best is None or finding.bytes_in > best.bytes_in:
            best = finding
    if best is None:
        raise ValueError("no speed to try")
    return best


def listen(transport: Transport, clock: Clock, duration_s: float) -> list[tuple[float, bytes]]:
    """Bytes that come within `duration_s`, with their arrival times."""
    begin_s = clock.now_s()
    chunks: list[tuple[float, bytes]] = []
    while (now_s := clock.now_s()) - begin_s < duration_s:
        data = transport.read_available(min(0.1, duration_s - (now_s - begin_s)))
        if data:
            chunks.append((clock.now_s() - begin_s, data))
    return chunks


def identify(chunks: Sequence[tuple[float, bytes]], duration_s: float, baud: int) -> Finding:
    """Say what the bytes of `listen` are."""
    data = b"".join(chunk for _, chunk in chunks)
    if not data:
        text = f"Nothing: no byte came in {duration_s:g} s. Check power, cable and port; some devices speak only when asked."
        return Finding(None, text, 0, 0, 0, math.nan, False)
    for kind, decoder in _candidates().items():
        frames = [f for f in decoder.feed(data) if _belongs(kind, f)]
        health = decoder.health()
        if len(frames) >= _MIN_FRAMES and health.bytes_skipped <= _MAX_LEFT_OVER * len(data):
            return _finding(kind, frames, len(data), _frames_a_second(len(frames), chunks, duration_s))
    others = vn100.messages(data)
    if len(others) >= _MIN_FRAMES:
        text = f"vn100: sends {others[-1]}, {len(others) / duration_s:.1f} a second; acquire selects VNIMU by itself."
        return Finding("vn100", text, len(data), len(others), 0, len(others) / duration_s, False)
    text = (
        f"{len(data)} bytes came in {duration_s:g} s at {baud} baud, and no known frame among them. "
        f"The baud rate is wrong, or it is another device. The first bytes: {data[:16].hex(' ')}."
    )
    return Finding(None, text, len(data), 0, 0, math.nan, False)


def _belongs(kind: str, frame: Frame) -> bool:
    """One codec reads both KVH formats; the header tells which it was."""
    if kind == "kvh-frame-a":
        return frame.raw.startswith(kvh_frame.HEADER_A)
    return kind != "kvh-frame-b" or frame.raw.startswith(kvh_frame.HEADER_B)


def _frames_a_second(frames: int, chunks: Sequence[tuple[float, bytes]], duration_s: float) -> float:
    """How often frames come, without what came at once: it had waited in a buffer since nobody knows when."""
    begin_s = _STALE_SHARE * duration_s
    fresh, all_bytes = (sum(len(data) for t_s, data in chunks if t_s >= after) for after in (begin_s, 0.0))
    return frames * fresh / all_bytes / (duration_s - begin_s)


def _finding(kind: str, frames: Sequence[Frame], bytes_in: int, rate_hz: float) -> Finding:
    bad = sum(f.status != 0 for f in frames)
    has_temperature = any(math.isfinite(f.temp_c) for f in frames)
    carries = (
        "with temperature" if has_temperature else "without temperature (take it from the chamber or a probe)"
    )
    state = "the device calls all of them good" if not bad else f"the device calls {bad} of {len(frames)} bad"
    text = f"{kind}: {rate_hz:.1f} frames a second, {carries}; {state}."
    return Finding(kind, text, bytes_in, len(frames), bad, rate_hz, has_temperature)
