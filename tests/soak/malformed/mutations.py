"""Faults in files: of bytes, of words, lines and values of texts."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable

import numpy as np

ODD_VALUES: tuple = (
    None, True, False, "", "x", "NaN", 0, -1, 1e308, -1e308, 10**400, 1e-320, float("nan"), float("inf"),
    -float("inf"), [], {}, [[]], [[[]]], {"a": {"a": {}}}, "\x00", "é" * 50, 2**63, 1e9, 1e6, 1e5,
)  # fmt: skip
ODD_WORDS = (
    b"nan", b"inf", b"-1", b"1e308", b"", b"x", b"9" * 400, b"0x10", b"\x00", b"2026-13-45T99:00:00", b"100", b",,,,",
    b'"', b"\xff\xfe", b"1e-320", b"aa:bb:cc:dd:ee:ff", b";", b"\r", b"null", b"[" * 3000, b'{"a":' * 3000,
    b"\\ud800", b"9" * 5000, b"/etc/passwd", b"../../../../../../etc/passwd", b"-Infinity",
)  # fmt: skip
_ODD_NUMBERS = (b"\xff" * 8, b"\x00" * 8, b"\x00\x00\x00\x00\x00\x00\xf8\x7f", b"\xff\xff\xff\x7f", b"\x00\x00\xc0\x7f")
"""Bytes of huge, zero and NaN numbers."""
Random = np.random.Generator
Change = Callable[[bytes, Random], bytes]


def mutated(raw: bytes, random: Random, changes: tuple[Change, ...] = ()) -> tuple[bytes, str]:
    """Bytes with one to three faults, and their names. changes: of this kind of file, besides those of any bytes."""
    names = []
    for _ in range(int(random.integers(1, 4))):
        own = changes and random.random() < 0.5
        kinds = changes if own else OF_BYTES
        change = kinds[int(random.integers(len(kinds)))]
        raw = change(raw or b"x", random)
        names.append(change.__name__)
    return raw, ", ".join(names)


def cut(raw: bytes, random: Random) -> bytes:
    """Only the beginning."""
    return raw[: int(random.integers(len(raw)))]


def flip(raw: bytes, random: Random) -> bytes:
    """Some other bytes, half of the time at the beginning."""
    changed = bytearray(raw)
    reach = len(raw) if random.random() < 0.5 else min(64, len(raw))
    for at in random.integers(0, reach, int(random.integers(1, 12))):
        changed[int(at)] = int(random.integers(256))
    return bytes(changed)


def bit(raw: bytes, random: Random) -> bytes:
    """One bit."""
    at = int(random.integers(len(raw)))
    return raw[:at] + bytes([raw[at] ^ (1 << int(random.integers(8)))]) + raw[at + 1 :]


def twice(raw: bytes, random: Random) -> bytes:
    """A piece twice."""
    begin, end = sorted(int(at) for at in random.integers(0, len(raw) + 1, 2))
    return raw[:end] + raw[begin:]


def without(raw: bytes, random: Random) -> bytes:
    """A piece left out."""
    at = int(random.integers(len(raw)))
    return raw[:at] + raw[at + int(random.integers(1, 200)) :]


def insert(raw: bytes, random: Random) -> bytes:
    """Noise between two bytes."""
    at = int(random.integers(len(raw)))
    return raw[:at] + random.bytes(int(random.integers(1, 40))) + raw[at:]


def odd_number(raw: bytes, random: Random) -> bytes:
    """The bytes of an odd number."""
    at, odd = int(random.integers(len(raw))), _ODD_NUMBERS[int(random.integers(len(_ODD_NUMBERS)))]
    return raw[:at] + odd + raw[at + len(odd) :]


OF_BYTES: tuple[Change, ...] = (cut, flip, bit, twice, without, insert, odd_number)


def odd_word(raw: bytes, random: Random) -> bytes:
    """Another word, between the blanks, commas, colons or semicolons of a text."""
    separators = [mark for mark in (b",", b" ", b";", b": ", b"\n", b" = ") if mark in raw] or [b","]
    mark = separators[int(random.integers(len(separators)))]
    words = raw.split(mark)
    words[int(random.integers(len(words)))] = ODD_WORDS[int(random.integers(len(ODD_WORDS)))]
    return mark.join(words)


def other_lines(raw: bytes, random: Random) -> bytes:
    """Lines in another order, left out, or twice."""
    lines = raw.split(b"\n")
    return b"\n".join(lines[k] for k in random.integers(0, len(lines), len(lines)))


OF_TEXT: tuple[Change, ...] = (odd_word, odd_word, odd_word, other_lines)


def odd_value(raw: bytes, random: Random) -> bytes:
    """Another value in JSON."""
    return _with_values(raw, random, _replace)


def dropped_key(raw: bytes, random: Random) -> bytes:
    """JSON without a value, or with it under another key."""
    return _with_values(raw, random, _drop)


def nested(raw: bytes, random: Random) -> bytes:
    """A value in many lists."""
    return _with_values(raw, random, _nest)


OF_JSON: tuple[Change, ...] = (odd_value, odd_value, odd_value, odd_value, odd_word, dropped_key, nested)


def _with_values(raw: bytes, random: Random, change: Callable) -> bytes:
    try:
        values = json.loads(raw)
    except (ValueError, RecursionError):  # it has another fault already
        return raw
    if not isinstance(values, (list, dict)) or not values:
        return raw
    change(values, random)
    return json.dumps(values).encode()


def _replace(values: list | dict, random: Random) -> None:
    holder, key = _somewhere(values, random)
    holder[key] = copy.deepcopy(ODD_VALUES[int(random.integers(len(ODD_VALUES)))])


def _drop(values: list | dict, random: Random) -> None:
    holder, key = _somewhere(values, random)
    kept = holder.pop(key)
    if isinstance(holder, dict) and random.random() < 0.5:
        holder[f"{key}s"] = kept


def _nest(values: list | dict, random: Random) -> None:
    holder, key = _somewhere(values, random)
    deep = holder[key]
    for _ in range(int(random.integers(1, 300))):
        deep = [deep]
    holder[key] = deep


def _somewhere(values, random: Random):
    """A random element of nested values: the list or dictionary that holds it, and its key."""
    holder, key = values, _key(values, random)
    while isinstance(holder[key], (list, dict)) and holder[key] and random.random() < 0.75:
        holder = holder[key]
        key = _key(holder, random)
    return holder, key


def _key(holder, random: Random):
    keys = list(holder) if isinstance(holder, dict) else range(len(holder))
    return keys[int(random.integers(len(keys)))]
