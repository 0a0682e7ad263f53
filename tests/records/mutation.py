"""Damage to a file's bytes, of the kinds that disks, transfers, editors and other programs do."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

#: What other programs, or a tired person, write where a number or a word stood.
STRANGE = (
    b"1e308",
    b"-1e308",
    b"1e999",
    b"1e154",
    b"1e-300",
    b"nan",
    b"Infinity",
    b"9" * 400,
    b"0x10",
    b"1_0",
    b"null",
    b"true",
    b'""',
    b"[]",
    b"{}",
    b"[" * 3000,
    b"{" * 3000,
    b'{"a":' * 3000,
    b"-",
    b"-0.0",
    b"1.7e9",
    b"\xef\xbb\xbf",
    b"\x00",
    b"\xff\xfe",
    b"\r",
    b"\n\n",
    b",",
    b";",
    b'"',
    b"$b_$",
    b"\\u0000",
    "1٣".encode(),
)


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    damaged = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        damaged[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    return bytes(damaged)


def _lose(data: bytes, rng: np.random.Generator) -> bytes:
    at, count = int(rng.integers(len(data))), int(rng.choice([1, 1, 1, 2, 7, 64, 4096]))
    return data[:at] + data[at + count :]


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: int(rng.integers(len(data)))]


def _repeat(data: bytes, rng: np.random.Generator) -> bytes:
    at, count = int(rng.integers(len(data))), int(rng.choice([1, 8, 512, 100_000]))
    return data[: at + count] + data[at:]


def _random(data: bytes, rng: np.random.Generator) -> bytes:
    at, count = int(rng.integers(len(data))), int(rng.choice([1, 4, 32]))
    return data[:at] + rng.bytes(count) + data[at + count :]


def _strange(data: bytes, rng: np.random.Generator) -> bytes:
    """Something strange in the place of a word or number."""
    at = int(rng.integers(len(data)))
    begin = end = at
    while begin > 0 and data[begin - 1 : begin] not in _BORDERS:
        begin -= 1
    while end < len(data) and data[end : end + 1] not in _BORDERS:
        end += 1
    return data[:begin] + STRANGE[int(rng.integers(len(STRANGE)))] + data[end:]


def _insert(data: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.choice([0, int(rng.integers(len(data)))]))
    return data[:at] + STRANGE[int(rng.integers(len(STRANGE)))] + data[at:]


def _lines(data: bytes, rng: np.random.Generator) -> bytes:
    """Two lines change places, or one is lost."""
    lines = data.split(b"\n")
    a, b = (int(k) for k in rng.integers(len(lines), size=2))
    lines[a], lines[b] = lines[b], lines[a]
    if rng.random() < 0.5:
        del lines[a]
    return b"\n".join(lines)


_BORDERS = (b",", b"\n", b" ", b":", b"=", b"[", b"]", b"{", b"}", b"")
_KINDS: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (
    _flip,
    _lose,
    _cut,
    _repeat,
    _random,
    _strange,
    _insert,
    _lines,
)


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """`data` damaged once, seldom twice."""
    for _ in range(1 + int(rng.random() < 0.2)):
        if data:
            data = _KINDS[int(rng.integers(len(_KINDS)))](data, rng)
    return data
