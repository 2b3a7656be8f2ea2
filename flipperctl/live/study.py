"""Studies with several people: who drives what how often, in which order, and what it took.

In: a YAML file and a person. Out: what is still to be driven, and a file of answers to NASA-TLX.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, field_validator

from flipperctl.config import EvalConfig, parse, strict_yaml
from flipperctl.errors import RequestError
from flipperctl.live.drives import PRACTICE, DriveFolder, Task
from flipperctl.policies.source import PolicySource
from flipperctl.text.files import write_bytes


class Study(BaseModel):
    """Who drives what how often, read from a YAML file."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    scenes: Annotated[dict[str, str], Field(min_length=1)]
    """Settings of each scene as words of ``eval``, such as ``terrain=step sim=mujoco``."""
    people: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names or codes; the order of the blocks is balanced over them."""
    helpers: tuple[str, ...] = ("none",)
    """Policies that share the control; ``none``: the person drives alone."""
    repeats: Annotated[int, Field(ge=1, le=1000)] = 3
    """Episodes of each scene that count."""
    practice: Annotated[int, Field(ge=0, le=100)] = 1
    """Episodes before them, on other draws, which do not count."""
    questions: bool = True
    """Whether NASA-TLX is asked after each block."""

    @field_validator("people", "helpers")
    @classmethod
    def _named_once(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"{name!r} is named twice")
        return names

    def blocks(self, person: str) -> list[tuple[str, str]]:
        """Return helper and scene of each block, in the order of this person.

        The rows of a balanced Latin square (Williams 1949): each block follows each other one
        equally often. An odd number of blocks needs every order backwards, too.
        """
        blocks = [(helper, scene) for helper in self.helpers for scene in self.scenes]
        count, at = len(blocks), self.people.index(person)
        # Steps 0, 1, -1, 2, -2 and so on: each distance between neighbours occurs once.
        middle = [(i + 1) // 2 if i % 2 else -(i // 2) for i in range(count)]
        row = [blocks[(step + at) % count] for step in middle]
        return row[::-1] if count % 2 and (at // count) % 2 else row


def read_study(path: Path, person: str) -> Study:
    """Read a study; ``person`` must be one of its people."""
    where = f"--study {path}"
    study = parse(Study, strict_yaml.read(path, where), where)
    if person not in study.people:
        raise RequestError(
            f"--as {person}: --study {path} has no such person; {', '.join(study.people)} are "
            "allowed"
        )
    return study


SCALES = ("mental", "physical", "temporal", "performance", "effort", "frustration")
"""Questions of NASA-TLX (Hart and Staveland 1988), 0 to 100."""
_ANSWERS = "answers.csv"


def tasks_of(
    study: Study,
    person: str,
    compose: Callable[[str], EvalConfig],
    find: Callable[[str], PolicySource],
    folder: Callable[[str], DriveFolder],
) -> Iterator[Task]:
    """Yield what a person has still to drive, block after block.

    ``compose`` returns the configuration of a scene's words, ``find`` a helper by its name, and
    ``folder`` the drives of the person with a helper.
    """
    # Practice comes before the first episode that counts, unless all are driven.
    for helper, scene in study.blocks(person):
        config, source = compose(study.scenes[scene]), None if helper == "none" else find(helper)
        drives = folder(helper)
        drives.check(config)
        missing = drives.missing(config, 0, study.repeats)
        task = Task(scene, config, 0, drives, source, repeatable=False)
        for index in range(PRACTICE, PRACTICE + study.practice) if missing else ():
            yield replace(task, index=index, practice=True)
        for index in missing:
            asks = scene if study.questions and index == missing[-1] else ""
            yield replace(task, index=index, asks=asks)


def add_answers(output: Path, person: str, helper: str, scene: str, answers: Sequence[int]) -> None:
    """Add a line of answers to ``answers.csv``; its last column is their mean (raw TLX)."""
    file, text = output / _ANSWERS, io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    if not file.exists():
        lines.writerow(["person", "helper", "scene", *SCALES, "mean"])
    lines.writerow([person, helper, scene, *answers, sum(answers) / len(answers)])
    before = file.read_bytes() if file.exists() else b""
    write_bytes(file, before + text.getvalue().encode())
