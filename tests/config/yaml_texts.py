"""Random mappings in YAML, as a user writes them, and what they mean."""

import random
from dataclasses import dataclass

_TEXTS = (
    *("035", "010", "08", "yes", "no", "on", "off", "y", "0x1F", "0o17", "0b101", "1_000", "12:30"),
    *("1:30.5", "2026-01-01", "inf", "nan", "+", "-", ".", "1e", "0x", "1.2.3", "="),
    "terrain=flat",
)
"""Plain scalars that are text, whatever YAML 1.1 reads."""
_VALUES = {
    "null": None, "~": None, "true": True, "FALSE": False, "7": 7, "-3": -3, "0": 0, "1e3": 1e3,
    "2.5": 2.5, ".5": 0.5, "5.": 5.0, "1E-2": 0.01, "-1.5e+2": -150.0, "00.5": 0.5,
}  # fmt: skip
"""Plain scalars that are values."""


@dataclass(frozen=True)
class Document:
    """A mapping in YAML."""

    text: str
    entries: list[tuple[str, object]]

    @property
    def twice(self) -> bool:
        """Whether a key has two values."""
        keys = [key for key, _ in self.entries]
        return len(set(keys)) < len(keys) or any(
            document.twice for _, document in self.entries if isinstance(document, Document)
        )


def document(rng: random.Random, depth: int = 0) -> Document:
    """Return a random mapping, in lines or in braces."""
    entries: list[tuple[str, object]] = []
    parts = []
    for _ in range(rng.randint(1, 5)):
        key = rng.choice((*_TEXTS[:-1], *_VALUES)) if rng.random() < 0.7 else f"k{rng.random()}"
        if key in "+-.=~":
            key += "k"
        quote = rng.choice(("", "", "'", '"'))
        value: object
        if depth < 2 and rng.random() < 0.2:
            inner = document(rng, depth + 2)
            value, text = inner, "{" + inner.text.replace("\n", ", ") + "}"
        elif rng.random() < 0.5:
            text = rng.choice(_TEXTS)
            value = text
            text = f"'{text}'" if text == "-" else text
        else:
            text, value = rng.choice(list(_VALUES.items()))
            if rng.random() < 0.3:
                value, text = text, f'"{text}"'
        entries.append((key, value))
        parts.append(f"{quote}{key}{quote}: {text}")
    return Document("\n".join(parts), entries)


def expected(made: Document) -> dict[str, object]:
    """Return what the document means."""
    return {k: expected(v) if isinstance(v, Document) else v for k, v in made.entries}
