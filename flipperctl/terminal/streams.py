"""Print any text on standard output and standard error.

A character that the encoding of a stream lacks (``LANG=C``, an old code page) is replaced by a
plain spelling, instead of an error.
"""

from __future__ import annotations

import codecs
import io
import sys

PLAIN = "flipperctl.plain"
"""Name of the error handler for codecs."""

_SPELLINGS = {
    "θ": "theta", "ε": "eps", "λ": "lambda", "γ": "gamma", "μ": "mu", "Δ": "d", "Σ": "sum",
    "\u0302": "^", "≥": ">=", "≤": "<=", "≈": "~", "×": "x", "·": "*", "±": "+-", "−": "-",
    "–": "-", "—": "-", "→": "->", "↑": "^", "°": "deg", "√": "sqrt", "π": "pi", "σ": "sigma",
    "‘": "'", "’": "'", "′": "'", "“": '"', "”": '"', "•": "*", "│": "|", "─": "-", "━": "-",
    "█": "#", "└": "+", "├": "+",
}  # fmt: skip


def plain_streams() -> None:
    """Make stdout and stderr replace characters that their encoding lacks."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # it is None if there is no console
            stream.reconfigure(errors=PLAIN)


def print_note(text: str) -> None:
    """Print a line on stderr, which leaves the results on stdout alone."""
    print(text, file=sys.stderr)


def log_to_stderr() -> None:
    """Print the package's log messages to stderr, for debugging."""
    import logging

    log = logging.getLogger("flipperctl")
    log.setLevel(logging.DEBUG)
    log.handlers[:] = [logging.StreamHandler()]


def spell_plainly(text: str, encoding: str) -> str:
    """Return the text with characters that this encoding lacks replaced."""
    return text.encode(encoding, PLAIN).decode(encoding, "surrogateescape")


def _spell(error: UnicodeError) -> tuple[str | bytes, int]:
    """Return a plain spelling of the first character without a code, and the index after it."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    import unicodedata  # only where a character is missing

    character = error.object[error.start]
    if "\udc80" <= character <= "\udcff":  # an undecodable byte of a file name
        return bytes([ord(character) - 0xDC00]), error.start + 1
    parts = unicodedata.normalize("NFKD", character)  # é is e and an accent, … three dots
    plain = "".join(part for part in parts if part.isascii())
    unknown = "" if unicodedata.combining(character) else "?"
    return _SPELLINGS.get(character) or plain or unknown, error.start + 1


codecs.register_error(PLAIN, _spell)
