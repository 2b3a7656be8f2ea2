"""Mutations of a file: of its bytes, or of the JSON and the numbers in it."""

import json
import re
from collections.abc import Callable
from typing import Any

import numpy as np

Rng = np.random.Generator
Mutation = Callable[[bytes, Rng], bytes]


def flips(data: bytes, rng: Rng) -> bytes:
    """Flip 1 to 20 bits."""
    return _flipped(data, rng, int(rng.integers(1, 21)))


def flips_at_the_start(data: bytes, rng: Rng) -> bytes:
    """Flip 1 to 8 bits of the first 500 bytes, where headers lie."""
    return _flipped(data[:500], rng, int(rng.integers(1, 9))) + data[500:]


def _flipped(data: bytes, rng: Rng, count: int) -> bytes:
    mutant = bytearray(data)
    for bit in rng.choice(8 * len(data), min(count, 8 * len(data)), replace=False):
        mutant[bit // 8] ^= 1 << (bit % 8)
    return bytes(mutant)


def truncate(data: bytes, rng: Rng) -> bytes:
    """Cut off the end."""
    return data[: int(rng.integers(0, len(data)))]


def blank(data: bytes, rng: Rng) -> bytes:
    """Set a part to zeros, as a disk that lost a block does."""
    at = int(rng.integers(0, len(data)))
    length = int(rng.integers(1, 600))
    part = data[at : at + length]
    return data[:at] + bytes(len(part)) + data[at + length :]


def insert(data: bytes, rng: Rng) -> bytes:
    """Insert random bytes."""
    at = int(rng.integers(0, len(data) + 1))
    return data[:at] + rng.bytes(int(rng.integers(1, 40))) + data[at:]


BYTES: dict[str, Mutation] = {
    m.__name__: m for m in (flips, flips_at_the_start, truncate, blank, insert)
}

NUMBERS = ("-1", "0", "1152921504606846976", "1" + "0" * 400, "nan", "inf", "1e300", "1,5", "x", "")


def number_at_the_start(data: bytes, rng: Rng) -> bytes:
    """Replace a number in the first 2,000 bytes."""
    found = list(re.finditer(rb"[0-9][0-9.]*", data[:2000]))
    if not found:
        return insert(data, rng)
    place = found[int(rng.integers(len(found)))]
    return data[: place.start()] + str(rng.choice(NUMBERS)).encode() + data[place.end() :]


VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 1, 9, 1.5, -2.5, 2**31, 2**63, 2**70, 10**300, 1e300, float("nan"),
    float("inf"), "", "x", "step", "ü\n\x1b[31m", "\ud800", "x" * 300, [], {}, [1, 2], [[]],
    {"name": "step"}, {"name": "flat", "more": 1}, {"name": []}, ["a"],
)  # fmt: skip


def document(value: Any, rng: Rng) -> str:
    """Return the JSON text of a document with up to three changes, or other or invalid text."""
    kind = int(rng.integers(12))
    if kind == 0:
        text = json.dumps(value)
        return str(rng.choice([text[:-1], text[: len(text) // 2], "[" * 50_000, "", "null", "[]"]))
    if kind == 1:
        depth = int(rng.integers(2, 400))
        return json.dumps(_changed(value, rng, json.loads('{"a":' * depth + "1" + "}" * depth)))
    if kind == 2:
        text = json.dumps(value)
        first = text.find('"')
        return (
            text[:first] + '"format": 2, ' + text[first:]
        )  # a key that occurs twice, if it has one
    changed = value
    for _ in range(int(rng.integers(1, 4))):
        changed = _changed(changed, rng, VALUES[int(rng.integers(len(VALUES)))])
    return json.dumps(changed)


def _changed(value: Any, rng: Rng, new: Any) -> Any:
    """Return a copy in which one random node is replaced, dropped or renamed."""
    if isinstance(value, dict) and value and rng.random() < 0.93:
        key = list(value)[int(rng.integers(len(value)))]
        act = rng.random()
        if act < 0.06:
            return {k: v for k, v in value.items() if k != key}
        if act < 0.1:
            return {(f"{k}_" if k == key else k): v for k, v in value.items()}
        return {**value, key: _changed(value[key], rng, new)}
    if isinstance(value, list) and value and rng.random() < 0.93:
        at = int(rng.integers(len(value)))
        if rng.random() < 0.1:
            return value[:at] + value[at + 1 :]
        return [*value[:at], _changed(value[at], rng, new), *value[at + 1 :]]
    return new
