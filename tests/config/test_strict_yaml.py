"""Files in YAML are read as they are written, with one value for a key; booleans are no numbers."""

import random
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from flipperctl.api import Robot
from flipperctl.config import TrainConfig, parse, strict_yaml, with_overrides
from flipperctl.errors import ConfigError
from flipperctl.evaluation.plan import find_suite

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


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("35", 35), ("-0", 0), ("1e3", 1000.0), (".5", 0.5), ("5.", 5.0), ("035.5", 35.5),
        ("1.5e-3", 0.0015), ("true", True), ("False", False), ("null", None), ("~", None),
        ("", None), ("035", "035"), ("0x23", "0x23"), ("0o43", "0o43"), ("0b11", "0b11"),
        ("1_000", "1_000"), ("12:30", "12:30"), ("yes", "yes"), ("off", "off"), ("'35'", "35"),
        ("2026-01-01", "2026-01-01"), ("!!str 35", "35"), ("!!float 3", 3.0), ("inf", "inf"),
    ],
)  # fmt: skip
def test_a_value_is_decimal_a_word_of_yaml_or_text(text: str, value: object) -> None:
    found = strict_yaml.parse(f"a: {text}", "x")["a"]
    assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("a: 1\nb: 2\na: 3", "x, line 3: a is given twice, also in line 1"),
        ("'8': 1\n8: 2", "8 is given twice"),
        ("a: {b: 1, b: 1}", "b is given twice"),
        ("? [1]\n: 2", "a key is a text"),
        ("a: &a [*a]", "recursive"),
        ("a: !!int 035", "'035' is not of the type !!int"),
        ("a: !!python/object:os.x 3", "could not determine a constructor"),
        ("a: " + 5000 * "9", "cannot be read"),
        ("[" * 1000, "nested too deeply"),
        ("a: 1\n--- \na: 2", "another document"),
    ],
)
def test_what_is_ambiguous_is_refused(text: str, error: str) -> None:
    with pytest.raises(ConfigError, match=error):
        strict_yaml.parse(text, "x")


def test_random_documents_are_read_as_they_are_written() -> None:
    for seed in range(100):
        rng = random.Random(seed)
        made = document(rng)
        try:
            assert strict_yaml.parse(made.text, "x") == expected(made), made.text
        except ConfigError:
            assert made.twice, made.text
        else:
            assert not made.twice, made.text


def test_scenes_have_the_names_that_are_written(tmp_path: Path) -> None:
    names = ["010", "8", "yes", "on", "1.0", "1", "1.10", "1.1", "12:30", "null"]
    file = tmp_path / "mine.yaml"
    file.write_text("scenes:\n" + "".join(f"  {name}: terrain=flat\n" for name in names))
    assert [scene.name for scene in find_suite(str(file)).scenes] == names
    file.write_text("scenes: {dry: sim.friction=1, wet: sim.friction=0.6, dry: sim.friction=0.4}")
    with pytest.raises(ConfigError, match="line 1: dry is given twice"):
        find_suite(str(file))


def test_a_boolean_is_no_number() -> None:
    config = parse(TrainConfig, {"terrain": "step", "network": "at_d3qn"})
    for change in ({"agent.n_step": np.False_}, {"robot.payload": True}):
        with pytest.raises(ConfigError, match="a number is allowed, not true or false"):
            with_overrides(config, change)
    assert with_overrides(config, {"train.record": True}).train.record
    assert Robot(payload=1).payload == 1.0
