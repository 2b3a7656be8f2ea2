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
from pathlib import Path
from typing import Any

import yaml

from flipperctl import checkpoint as checkpoints
from flipperctl.checkpoint import Checkpoint
from flipperctl.checkpoint.results import summary_of
from flipperctl.config import DEFAULT_LEARNER, TrainConfig, strict_yaml
from flipperctl.config.describe import settings
from flipperctl.config.identity import content_digest
from flipperctl.errors import ConfigError, RequestError
from flipperctl.evaluation.names import names
from flipperctl.evaluation.store import FOLDER, played_policies
from flipperctl.evaluation.stored import SUMMARY, read_document
from flipperctl.policies.identity import PolicyIdentity
from flipperctl.policies.source import PolicySource
from flipperctl.text.files import OutputKind
from flipperctl.text.show import NONE, Column, Table, markdown
from flipperctl.views.summary import compared, risk_text

MEASURES = (
    "pitch_variation_100hz",
    "pitch_variation_decisions",
    "t_cost",
    "max_pitch",
    "flipper_travel",
    "flipper_energy",
)
"""Measures of a row; all but ``max_pitch`` are over the episodes that reached the finish."""
RISK = (
    "horizon",
    "threshold",
    "failures",
    "announced",
    "reached",
    "false_alarms",
    "false_warnings",
)
"""What a row keeps of how a policy's risk fits the ends of its episodes."""
Ends = Sequence[float | None]
"""Mean, and the ends of its 95 % interval, None for fewer than five values."""
StoredRow = dict[str, Any]
"""One method on one scene: ``terrain``, ``conditions`` and their ``hash``, ``engine``, ``seed``,
``method``, ``is_policy``, ``episodes``, ``outcomes``, ``success`` and ``measures`` as ends, the
policy's ``difference`` from a baseline in θ̂_R at 100 Hz, counts of its ``risk``, and of its
``passable`` episodes with the names of the references."""
_OVERRIDES = Path(".hydra") / "overrides.yaml"  # where a run keeps the words of its command
CARD = OutputKind("a card", (".md",), re.compile(rb"\A---\nlibrary_name: flipperctl\n"))
TAGS = ("robotics", "reinforcement-learning", "tracked-robot", "flipper-control")
_TASK = {"type": "reinforcement-learning", "name": "flipper control of a tracked robot"}
_METRICS = {
    "pitch_variation_100hz": "pitch variation at 100 Hz where reached [rad]",
    "pitch_variation_decisions": "pitch variation at decisions where reached [rad]",
    "t_cost": "time to the finish [s]",
}
_COLUMNS = (
    Column("terrain", "terrain"),
    Column("conditions", "conditions"),
    Column("method", "policy"),
    Column("episodes", "episodes"),
    Column("reached", "reached"),
    Column("success", "success"),
    Column("pitch_variation_100hz", "θ̂_R [rad]"),
    Column("pitch_variation_decisions", "θ̂_R at decisions [rad]"),
    Column("t_cost", "time [s]"),
    Column("flipper_energy", "flipper energy [J]"),
)
_PASSABLE = Column("passable", "of passable")
_DIFFERENCES = (
    Column("terrain", "terrain"),
    Column("conditions", "conditions"),
    Column("method", "θ̂_R minus that of"),
    Column("difference", "difference [rad]"),
)
_SECTIONS = (
    "agent",
    "network",
    "rewards",
    "teacher",
    "train",
    "episode",
    "perception",
    "robot",
    "sim",
    "randomise",
)
"""Sections whose changed settings the card lists."""


def rows_of(document: Mapping[str, Any]) -> Iterator[StoredRow]:
    """Yield the rows of a document of ``eval --json``; in each scene the policy's is the first."""
    for scene in document["scenes"]:
        for method in (scene, *compared(scene)):
            yield _row(scene, method, is_policy=method is scene)


def _row(scene: Mapping[str, Any], method: Mapping[str, Any], *, is_policy: bool) -> StoredRow:
    conditions, risk, passable = scene["conditions"], method.get("risk"), _passable(method)
    return {
        "terrain": scene["terrain"],
        "conditions": conditions["name"],
        "hash": conditions["hash"],
        "engine": conditions["sim"]["name"],
        "seed": scene["seed"],
        "method": method["controller"],
        "is_policy": is_policy,
        "episodes": method["episodes"],
        "outcomes": dict(method["outcomes"]),
        "success": _ends(method["success"]),
        "measures": {name: _ends(method[name]) for name in MEASURES},
        "difference": None if is_policy else _ends(method["difference"]["pitch_variation_100hz"]),
        **({} if risk is None else {"risk": {name: risk[name] for name in RISK}}),
        **({} if passable is None else {"passable": passable}),
    }


def _passable(method: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the counts of passable episodes; None if it is not known which references count."""
    passable = method.get("passable", {})
    if "references" not in passable:
        return None
    crossed = round((passable["success_rate"] or 0.0) * passable["episodes"])
    return {name: passable[name] for name in ("episodes", "references")} | {"reached": crossed}


def _ends(interval: Mapping[str, Any] | None) -> Ends | None:
    """Return mean and ends, with the six digits that tables need at most."""
    if interval is None:
        return None
    ends = (interval[name] for name in ("mean", "low", "high"))
    return tuple(None if end is None else float(f"{end:.6g}") for end in ends)


def ends_text(ends: Ends | None, digits: int, *, interval: bool = True) -> str:
    """Return a mean with ``digits`` decimals and, if there is one, its interval."""
    if ends is None:
        return NONE
    mean, low, high = ends
    text = f"{mean:.{digits}f}"
    if not interval or low is None or high is None:
        return text
    return f"{text} [{low:.{digits}f}, {high:.{digits}f}]"


def _rows_of_all(folder: Path) -> list[StoredRow]:
    """Return the rows of a folder of ``eval --output``."""
    document, path = read_document(folder), folder / SUMMARY
    try:
        # A card must not be made of half an evaluation.
        if document.get("interrupted"):
            raise RequestError(
                f"{path}: its evaluation was interrupted; eval with the same words and --output "
                "goes on"
            )
        if failed := document.get("failed"):
            raise RequestError(
                f"{path}: results are missing, since {failed[0]['controller']} failed on "
                f"{failed[0]['terrain']}"
            )
        return list(rows_of(document))
    except (KeyError, TypeError, AttributeError) as error:
        raise RequestError(f"{path}: it holds no results of eval; it lacks {error}") from error


def policy_rows(file: Path, results: Sequence[Path]) -> list[StoredRow]:
    """Return the stored results of a policy and its baselines by their short names."""
    result = []
    for folder in results:
        rows, played = _rows_of_all(folder), played_policies(folder / FOLDER)
        policies = list(dict.fromkeys(row["method"] for row in rows if row["is_policy"]))
        # Results of another policy would stand in its card as its own.
        others = [method for method in policies if not _is(method, file)]
        if others == policies:
            raise RequestError(f"{folder}: it holds results of {', '.join(others)}, not of {file}")
        if others:
            raise RequestError(
                f"{folder}: it holds results of {', '.join(others)}, too; a card is of one policy "
                "and its baselines: evaluate it with --baseline geometric,level, alone"
            )
        # Weights that have changed since then belong to another policy.
        for row in (row for row in rows if row["is_policy"]):
            digests = played.get((row["method"], row["hash"]), set())
            if digests and PolicyIdentity.of(PolicySource(checkpoint=file)).digest not in digests:
                raise RequestError(
                    f"{folder}: {row['method']} had other weights there than {file} has now; "
                    "evaluate it again"
                )
        called = names([row["method"] for row in rows])
        result += [row | {"method": called[row["method"]]} for row in rows]
    return result


def commands_of(results: Sequence[Path]) -> list[str]:
    """Return the commands that made stored results; those of Python have none."""
    documents = map(read_document, results)
    return [document["command"] for document in documents if "command" in document]


def _is(label: str, file: Path) -> bool:
    """Return whether a label of results names a policy's file, or a file of equal content."""
    if label == PolicySource(checkpoint=file).label():
        return True
    other = Path(label)
    return other.is_file() and content_digest(other) == content_digest(file)


def card_text(policy: Path, file: Path, rows: Sequence[StoredRow], commands: Sequence[str]) -> str:
    """Return the card of a policy; ``policy`` is the name or path, ``file`` its checkpoint.

    ``rows``: results of ``policy_rows``; ``commands``: commands that made the results.
    """
    saved = checkpoints.read(file)
    label = PolicySource(checkpoint=file).label()
    name = policy.name if policy.is_dir() else Path(label).stem
    parts = [front_matter(name, rows), f"# {name}\n", *_training(policy, saved)]
    parts += [*results(rows), *limits(rows)]
    if commands:
        parts += ["## Commands\n", "```sh\n" + "\n".join(commands) + "\n```\n"]
    return "\n".join(parts)


def front_matter(name: str, rows: Sequence[StoredRow]) -> str:
    """Return the front matter, whose ``model-index`` has the policy's own results."""
    head: dict[str, Any] = {"library_name": "flipperctl", "tags": list(TAGS)}
    if rows:
        policy_results = [_result(row) for row in rows if row["is_policy"]]
        head["model-index"] = [{"name": name, "results": policy_results}]
    text = yaml.safe_dump(head, sort_keys=False, allow_unicode=True, width=100)
    return f"---\n{text}---\n"


def _result(row: StoredRow) -> dict[str, Any]:
    success = {"type": "success_rate", "value": row["success"][0], "name": "success rate"}
    measured = [(key, words, row["measures"][key]) for key, words in _METRICS.items()]
    metrics = [{"type": key, "value": e[0], "name": words} for key, words, e in measured if e]
    return {
        "task": dict(_TASK),
        "dataset": {
            "name": f"{row['terrain']}, conditions {row['conditions']} {row['hash']}",
            "type": f"flipperctl/{row['terrain']}",
            "args": {"episodes": row["episodes"], "seed": row["seed"], "engine": row["engine"]},
        },
        "metrics": [success, *metrics],
    }


def _training(policy: Path, saved: Checkpoint) -> Iterator[str]:
    """Yield what the policy is for, and how it was trained."""
    config, document = saved.policy_config(), saved.document
    robot = config.robot
    yield "## What it is for\n"
    yield (
        f"It controls the flippers of a tracked robot (chassis {robot.chassis_length:g} m, "
        f"flippers {robot.flipper_length:g} m, tracks {robot.track_speed:g} m/s): at each decision "
        "it maps terrain heights, flipper angles and pitch to turns of the flippers. "
        "It was trained in simulation; nothing here says how it does on a robot.\n"
    )
    yield "## How it was trained\n"
    # The best checkpoint says at which decision it was chosen; a last one has the run's state.
    state = document.state
    count = document.decision if state is None or document.decision is not None else state.decision
    seconds = summary_of(policy).get("seconds")
    whole = "" if seconds is None else f" ({seconds:,.0f} s in all)"
    decisions = (
        "" if count is None else f", after {count:,} of {config.train.decisions:,} decisions"
    )
    yield (
        f"Network `{config.network.plugin_name}` on the terrain `{config.terrain.title}`, "
        f"seed {config.seed}{decisions}{whole}, with "
        f"flipperctl {document.versions['flipperctl']}.\n"
    )
    # The command, if the run's folder has it, and what it and presets changed
    try:
        words = strict_yaml.read(policy / _OVERRIDES, _OVERRIDES.parent.name)
        yield f"```sh\n{shlex.join(['flipperctl', 'train', *map(str, words or ())])}\n```\n"
    except ConfigError:
        pass  # the command is not known
    if changed := _changed(config):
        yield "Settings that presets or the command changed from a plugin's defaults:\n"
        yield "| setting | value |\n|---|---|"
        yield from (f"| `{path}` | {value} |" for path, value in changed.items())
        yield ""
    yield f"SHA-256 of configuration and weights: `{saved.content}`\n"


def _changed(config: TrainConfig) -> dict[str, Any]:
    """Return the settings that differ from their defaults, by path, as JSON."""
    changed = {}
    for setting in settings(config):
        listed = setting.path.partition(".")[0] in _SECTIONS and "[" not in setting.path
        plugin = setting.path == setting.section and setting.path not in (
            "agent",
            "teacher.controller",
        )
        default = DEFAULT_LEARNER if setting.path == "agent" else setting.field.default
        if listed and not plugin and setting.value not in (default, {}):
            changed[setting.path] = json.dumps(setting.value)
    return changed


def results(rows: Sequence[StoredRow]) -> Iterator[str]:
    """Yield the tables of the policy and its baselines, and the table of their differences."""
    yield "## Results\n"
    if not rows:
        yield "None yet: `flipperctl card POLICY RESULT_DIR` adds those of `eval --output`.\n"
        return
    gaps = [_texts(row) for row in rows if row["difference"] is not None]
    paired = " The last table has paired differences." if gaps else ""
    yield (
        "θ̂_R is the sum of the absolute pitch changes, at 100 Hz and at decisions, over the "
        f"episodes that reached the finish; 95 % intervals.{paired}\n"
    )
    # A table for each set of conditions, then the differences
    together: dict[str, list[StoredRow]] = {}
    for row in rows:
        label = f"`{row['conditions']}`, engine `{row['engine']}`, seed {row['seed']}"
        together.setdefault(label, []).append(_texts(row))
    references = dict.fromkeys(
        ", ".join(r["passable"]["references"]) for r in rows if "passable" in r
    )
    for crossing in references:
        yield f"Passable are the episodes that one of these crosses: {crossing}.\n"
    for label, table_rows in together.items():
        yield f"Conditions {label}:\n"
        columns = (*_COLUMNS, _PASSABLE) if references else _COLUMNS
        yield from (*markdown(Table(columns, table_rows)), "")
    if gaps:
        yield from (*markdown(Table(_DIFFERENCES, gaps)), "")


def _texts(row: StoredRow) -> StoredRow:
    """Return a row with the texts of the card's tables."""
    digits = {
        "pitch_variation_100hz": 2,
        "pitch_variation_decisions": 2,
        "t_cost": 1,
        "flipper_energy": 0,
    }
    passable = row.get("passable")
    return {
        **{name: ends_text(row["measures"][name], n) for name, n in digits.items()},
        "terrain": f"`{row['terrain']}`",
        "conditions": f"{row['conditions']} {row['hash']}",
        "method": f"`{row['method']}`",
        "episodes": row["episodes"],
        "reached": row["outcomes"]["reached"],
        "success": ends_text(row["success"], 3),
        "passable": f"{passable['reached']} of {passable['episodes']}" if passable else NONE,
        "difference": ends_text(row["difference"], 2),
    }


def limits(rows: Sequence[StoredRow]) -> Iterator[str]:
    """Yield where the policy fails, and where it is worse than a baseline."""
    yield "## Limits\n"
    # Where the policy itself fails
    own_rows = [row for row in rows if row["is_policy"]]
    failed = [row for row in own_rows if row["outcomes"]["reached"] < row["episodes"]]
    for row in failed:
        outcomes = row["outcomes"].items()
        causes = ", ".join(
            f"{n} {outcome}" for outcome, n in outcomes if n and outcome != "reached"
        )
        missed = f"{row['episodes'] - row['outcomes']['reached']} of {row['episodes']}"
        yield f"- `{row['terrain']}` ({row['hash']}): {missed} not reached: {causes}."
    if own_rows and not failed:
        yield "- Every evaluated episode reached the finish."
    # Baselines that are smoother beyond chance
    for row in rows:
        low = row["difference"][1] if row["difference"] is not None else None
        if low is not None and low > 0:
            yield (
                f"- `{row['terrain']}` ({row['hash']}): a larger θ̂_R than `{row['method']}`, by "
                f"{ends_text(row['difference'], 2)} rad."
            )
    for row in own_rows:
        if "risk" in row:
            yield f"- Its risk on `{row['terrain']}` ({row['hash']}): {risk_text(row['risk'])}."
    yield "- Other robots, terrains and conditions than those above were not evaluated.\n"
