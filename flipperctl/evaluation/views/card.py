"""A policy's card: a Markdown page with the front matter of the Hugging Face Hub.

In: a run, a checkpoint or the name of a shipped policy, and folders of ``eval --output``. Out: the
text of the card. The front matter has a ``model-index``, whose results have the form of
``huggingface_hub.EvalResult``.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from flipperctl import checkpoint as checkpoints
from flipperctl.checkpoint import Checkpoint
from flipperctl.config import TrainConfig, strict_yaml
from flipperctl.config.describe import settings
from flipperctl.config.identity import content_digest
from flipperctl.errors import ConfigError, RequestError
from flipperctl.evaluation.store import FOLDER, played_policies
from flipperctl.evaluation.stored import SUMMARY
from flipperctl.evaluation.views import risk
from flipperctl.evaluation.views.markdown import StoredRow, ends_text, markdown_table, read_rows
from flipperctl.files import OutputKind
from flipperctl.policies.identity import PolicyIdentity
from flipperctl.policies.source import PolicySource

_OVERRIDES = Path(".hydra") / "overrides.yaml"
"""Where a run keeps the words of its command."""
CARD = OutputKind("a card", (".md",), re.compile(rb"\A---\nlibrary_name: flipperctl\n"))
TAGS = ("robotics", "reinforcement-learning", "tracked-robot", "flipper-control")
_TASK = {"type": "reinforcement-learning", "name": "flipper control of a tracked robot"}
_METRICS = {
    "pitch_variation_100hz": "pitch variation at 100 Hz where reached [rad]",
    "pitch_variation": "pitch variation at decisions where reached [rad]",
    "t_cost": "time to the finish [s]",
}
_COLUMNS = (
    "terrain",
    "conditions",
    "method",
    "n",
    "reached",
    "success",
    "swing+",
    "decisions+",
    "time+",
)


@dataclass(frozen=True)
class CardFacts:
    """What a card tells."""

    name: str
    content: str
    """SHA-256 of the policy's content."""
    version: str
    """Version of the package that trained it."""
    network: str
    terrain: str
    """Terrain of the training."""
    seed: int
    """Seed of the training."""
    decisions: int | None
    seconds: float | None
    """Duration of the training [s]; None if the run's summary is missing."""
    robot: str
    """The robot's settings in words."""
    training: str | None
    """Command of the training; None if it is not known."""
    settings: Mapping[str, Any]
    """Settings of the training that differ from the defaults, by path."""
    rows: Sequence[StoredRow]
    """Results of the policy and its baselines."""
    commands: Sequence[str]
    """Commands that make the results again."""


def card_text(facts: CardFacts) -> str:
    """Return the whole card."""
    parts = [
        _front_matter(facts),
        f"# {facts.name}\n",
        *_use(facts),
        *_training(facts),
        *_results(facts),
        *_limits(facts),
        *_commands(facts),
    ]
    return "\n".join(parts)


def model_index(facts: CardFacts) -> list[dict[str, Any]]:
    """Return the ``model-index`` of the policy's own results."""
    results = [_result(row) for row in facts.rows if row["is_policy"]]
    return [{"name": facts.name, "results": results}]


def _front_matter(facts: CardFacts) -> str:
    head: dict[str, Any] = {"library_name": "flipperctl", "tags": list(TAGS)}
    if facts.rows:
        head["model-index"] = model_index(facts)
    text = yaml.safe_dump(head, sort_keys=False, allow_unicode=True, width=100)
    return f"---\n{text}---\n"


def _result(row: StoredRow) -> dict[str, Any]:
    metrics: list[dict[str, Any]] = [
        {"type": "success_rate", "value": row["success"][0], "name": "success rate"}
    ]
    for name, words in _METRICS.items():
        if (ends := row["measures"][name]) is not None:
            metrics.append({"type": name, "value": ends[0], "name": words})
    return {
        "task": dict(_TASK),
        "dataset": {
            "name": f"{row['terrain']}, conditions {row['conditions']} {row['hash']}",
            "type": f"flipperctl/{row['terrain']}",
            "args": {"episodes": row["episodes"], "seed": row["seed"], "engine": row["engine"]},
        },
        "metrics": metrics,
    }


def _use(facts: CardFacts) -> Iterator[str]:
    yield "## What it is for\n"
    yield (
        f"It controls the flippers of a tracked robot ({facts.robot}): at each decision it maps "
        "terrain heights, flipper angles and pitch to one of nine turns of the flippers. It was "
        "trained in simulation; nothing here says how it does on a robot.\n"
    )


def _training(facts: CardFacts) -> Iterator[str]:
    yield "## How it was trained\n"
    decisions = "" if facts.decisions is None else f", {facts.decisions:,} decisions"
    seconds = "" if facts.seconds is None else f" in {facts.seconds:,.0f} s"
    yield (
        f"Network `{facts.network}` on the terrain `{facts.terrain}`, seed {facts.seed}{decisions}"
        f"{seconds}, with flipperctl {facts.version}.\n"
    )
    if facts.training is not None:
        yield f"```sh\n{facts.training}\n```\n"
    if facts.settings:
        yield "Settings that differ from the defaults:\n"
        yield "| setting | value |\n|---|---|"
        yield from (f"| `{path}` | {value} |" for path, value in facts.settings.items())
        yield ""
    yield f"SHA-256 of configuration and weights: `{facts.content}`\n"


def _results(facts: CardFacts) -> Iterator[str]:
    yield "## Results\n"
    if not facts.rows:
        yield "None yet: `flipperctl card POLICY RESULT_DIR` adds those of `eval --output`.\n"
        return
    yield (
        "θ̂_R is the sum of the absolute pitch changes, at 100 Hz and at decisions, over the "
        "episodes that reached the finish; 95 % intervals. The last table has paired differences.\n"
    )
    for label, rows in _by_conditions(facts.rows).items():
        yield f"Conditions {label}:\n"
        yield from markdown_table(rows, _COLUMNS)
        yield ""
    differences = [row for row in facts.rows if row["difference"] is not None]
    if differences:
        yield "| terrain | conditions | θ̂_R minus that of | difference [rad] |\n|---|---|---|---|"
        for row in differences:
            text = ends_text(row["difference"], 2)
            where = f"`{row['terrain']}` | {row['conditions']} {row['hash']}"
            yield f"| {where} | `{row['method']}` | {text} |"
        yield ""


def _by_conditions(rows: Sequence[StoredRow]) -> dict[str, list[StoredRow]]:
    """Return the rows by the name of their conditions, engine and seed, in their order."""
    found: dict[str, list[StoredRow]] = {}
    for row in rows:
        label = f"`{row['conditions']}`, engine `{row['engine']}`, seed {row['seed']}"
        found.setdefault(label, []).append(row)
    return found


def _limits(facts: CardFacts) -> Iterator[str]:
    yield "## Limits\n"
    own = [row for row in facts.rows if row["is_policy"]]
    failed = [row for row in own if row["outcomes"]["reached"] < row["episodes"]]
    for row in failed:
        causes = ", ".join(
            f"{count} {outcome}"
            for outcome, count in row["outcomes"].items()
            if count and outcome != "reached"
        )
        missed = row["episodes"] - row["outcomes"]["reached"]
        where = f"`{row['terrain']}` ({row['hash']})"
        yield f"- {where}: {missed} of {row['episodes']} not reached: {causes}."
    if own and not failed:
        yield "- Every evaluated episode reached the finish."
    for row in facts.rows:
        low = row["difference"][1] if row["difference"] is not None else None
        if low is not None and low > 0:
            yield (
                f"- `{row['terrain']}` ({row['hash']}): a larger θ̂_R than `{row['method']}`, by "
                f"{ends_text(row['difference'], 2)} rad."
            )
    for row in own:
        if "risk" in row:
            yield f"- Its risk on `{row['terrain']}` ({row['hash']}): {risk.text(row['risk'])}."
    yield "- Other robots, terrains and conditions than those above were not evaluated.\n"


def _commands(facts: CardFacts) -> Iterator[str]:
    if facts.commands:
        yield "## Commands\n"
        yield "```sh\n" + "\n".join(facts.commands) + "\n```\n"


_SECTIONS = (
    *("agent", "network", "rewards", "teacher", "train"),
    *("episode", "perception", "robot", "sim", "randomise"),
)
"""Sections whose changed settings the card lists."""


def card_facts(
    policy: Path, file: Path, results: Sequence[Path], commands: Sequence[str] = ()
) -> CardFacts:
    """Return the facts about a policy; ``policy`` is the name or path, ``file`` its checkpoint.

    Raises:
        CheckpointError: the checkpoint cannot be read.
        RequestError: a folder holds no results, or those of another policy.
    """
    saved = checkpoints.read(file)
    config, document = saved.policy_config(), saved.document
    robot = config.robot
    label = PolicySource(checkpoint=file).label()
    return CardFacts(
        name=policy.name if policy.is_dir() else Path(label).stem,
        content=saved.content,
        version=document.versions["flipperctl"],
        network=config.network.plugin_name,
        terrain=config.terrain.plugin_name,
        seed=config.seed,
        decisions=_decisions(saved),
        seconds=_seconds(policy),
        robot=f"chassis {robot.chassis_length:g} m, flippers {robot.flipper_length:g} m, tracks "
        f"{robot.track_speed:g} m/s",
        training=_command(policy),
        settings=_changed(config),
        rows=policy_rows(file, results),
        commands=commands,
    )


def policy_rows(file: Path, results: Sequence[Path]) -> list[StoredRow]:
    """Return the stored results of a policy and its baselines; the label becomes its name.

    Raises:
        RequestError: a folder holds no results, those of another policy, or those of other weights.
    """
    found = []
    for folder in results:
        rows, played = read_rows(folder), played_policies(folder / FOLDER)
        policies = list(dict.fromkeys(row["method"] for row in rows if row["is_policy"]))
        others = [method for method in policies if not _is(method, file)]
        if others == policies:
            raise RequestError(f"{folder}: it holds results of {', '.join(others)}, not of {file}")
        if others:
            raise RequestError(
                f"{folder}: it holds results of {', '.join(others)}, too; a card is of one policy "
                "and its baselines: evaluate it with --baseline okada,level, alone"
            )
        for row in rows:
            if not row["is_policy"]:
                continue
            digests = {one.digest for one in played.get((row["method"], row["hash"]), ())}
            if digests and PolicyIdentity.of(PolicySource(checkpoint=file)).digest not in digests:
                raise RequestError(
                    f"{folder}: {row['method']} had other weights there than {file} has now; "
                    "evaluate it again"
                )
        found += rows
    return found


def _is(label: str, file: Path) -> bool:
    """Return whether a label of results names a policy's file, or a file of equal content."""
    if label == PolicySource(checkpoint=file).label():
        return True
    other = Path(label)
    return other.is_file() and content_digest(other) == content_digest(file)


def _decisions(saved: Checkpoint) -> int | None:
    document = saved.document
    if document.decision is not None:
        return document.decision
    return document.state.decision if document.state is not None else None


def _seconds(run: Path) -> float | None:
    """Return the duration of a run's training [s], if its summary is there."""
    try:
        found: Any = json.loads((run / SUMMARY).read_text(encoding="utf-8"))["seconds"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return float(found)


def _command(run: Path) -> str | None:
    """Return the command of a run, from the overrides that were stored with it."""
    try:
        words = strict_yaml.read(run / _OVERRIDES, _OVERRIDES.parent.name)
    except ConfigError:
        return None
    return shlex.join(["flipperctl", "train", *map(str, words or ())])


def _changed(config: TrainConfig) -> dict[str, Any]:
    """Return the settings that differ from their defaults, by path, as JSON."""
    found = {}
    for setting in settings(config):
        chosen = setting.path.partition(".")[0] in _SECTIONS and "[" not in setting.path
        plugin = setting.path == setting.section and setting.path != "teacher.controller"
        if chosen and not plugin and setting.value not in (setting.field.default, {}):
            found[setting.path] = json.dumps(setting.value)
    return found
