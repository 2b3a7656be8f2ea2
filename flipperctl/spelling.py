"""Spell characters that an encoding lacks (``LANG=C``, an old code page) plainly: θ as theta."""

from __future__ import annotations

import codecs

PLAIN = "flipperctl.plain"
"""Name of the error handler for codecs."""

_SPELLINGS = {
    "θ": "theta", "ε": "eps", "λ": "lambda", "γ": "gamma", "μ": "mu", "Δ": "d", "Σ": "sum",
    "\u0302": "^", "≥": ">=", "≤": "<=", "≈": "~", "×": "x", "·": "*", "±": "+-", "−": "-",
    "–": "-", "—": "-", "→": "->", "↑": "^", "°": "deg", "√": "sqrt", "π": "pi", "σ": "sigma",
    "‘": "'", "’": "'", "′": "'", "“": '"', "”": '"', "•": "*", "│": "|", "─": "-", "━": "-",
    "█": "#", "└": "+", "├": "+",
}  # fmt: skip


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
