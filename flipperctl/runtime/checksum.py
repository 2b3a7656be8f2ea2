"""The SHA-256 of an exported policy, stored in the file that it covers.

In: the bytes of a file. Out: the bytes with their checksum, or an error before any other code
parses them. The checksum is computed over the whole file with its own 64 hexadecimal digits set to
0, so that it covers every bit of graph and metadata.
"""

from __future__ import annotations

import hashlib
import re

from flipperctl.errors import PolicyError

FORMAT_VERSION = 2
"""Format of the metadata under ``flipperctl.*``; 1 had no checksum and only the terrain's name."""
PREFIX = "flipperctl."
CHECKSUM = f"{PREFIX}sha256"
PLACEHOLDER = "0" * 64
"""Value of the checksum entry while the checksum is computed."""
_NAME = re.compile(re.escape(PREFIX).encode() + rb"\w*")
_FORMAT = f"{PREFIX}format_version"
_FORMAT_1_ENTRIES = frozenset(
    f"{PREFIX}{name}".encode()
    for name in (
        *("format_version", "package_version", "observation", "bins", "bin_width", "frames"),
        *("actions", "decision_period", "robot", "terrain", "seed", "network"),
    )
)


def add_checksum(data: bytes) -> bytes:
    """Return a model's bytes with their checksum in place of ``PLACEHOLDER``.

    Raises:
        ValueError: the entry ``CHECKSUM`` does not hold the placeholder exactly once.
    """
    start = _find_entry(data, CHECKSUM, len(PLACEHOLDER))
    if start is None or data[start : start + len(PLACEHOLDER)] != PLACEHOLDER.encode():
        raise ValueError(f"the model's metadata must hold {CHECKSUM} once, as the placeholder")
    return _replace_at(data, start, hashlib.sha256(data).hexdigest())


def verify(data: bytes, where: str) -> bool:
    """Check the bytes of a file; return whether they have a checksum (format 1 has none).

    Raises:
        PolicyError: the bytes were changed since the export, or ``flipperctl export onnx`` did not
            write them.
    """
    start = _find_entry(data, CHECKSUM, len(PLACEHOLDER))
    if start is not None:
        found = data[start : start + len(PLACEHOLDER)]
        expected = hashlib.sha256(_replace_at(data, start, PLACEHOLDER)).hexdigest()
        if found != expected.encode():
            raise PolicyError(
                f"{where} is damaged, or was changed since its export: "
                "its SHA-256 does not match its contents"
            )
        return True
    version = _find_entry(data, _FORMAT, 1)
    if version is None:
        raise PolicyError(
            f"{where} is damaged, or not a file of flipperctl export onnx: it holds no {_FORMAT}"
        )
    found_version = data[version : version + 1]
    if found_version == b"1" and _FORMAT_1_ENTRIES.issuperset(re.findall(_NAME, data)):
        return False
    # Without a checksum, only the entries of format 1 are possible: this file is damaged.
    if found_version in (b"1", b"%d" % FORMAT_VERSION):
        raise PolicyError(f"{where} is damaged: its SHA-256 cannot be found")
    raise PolicyError(
        f"{where} has format version {found_version.decode(errors='replace')!r}, or is damaged; "
        f"this version of flipperctl reads 1 and {FORMAT_VERSION}"
    )


def _find_entry(data: bytes, key: str, length: int) -> int | None:
    """Return the offset of a metadata entry's value; None unless one of that length exists.

    An entry is a protobuf message of two strings: tag 1, length, key, tag 2, length, value. An
    entry that occurs twice counts as missing.
    """
    marker = b"\x0a%c%b\x12%c" % (len(key), key.encode(), length)
    at = data.find(marker)
    start = at + len(marker)
    if at < 0 or data.find(marker, start) >= 0 or start + length > len(data):
        return None
    return start


def _replace_at(data: bytes, start: int, value: str) -> bytes:
    return data[:start] + value.encode() + data[start + len(value) :]
