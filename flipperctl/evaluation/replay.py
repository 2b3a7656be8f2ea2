"""Episodes that are played again from a small file, bit for bit.

In: an episode of an evaluation, its configuration and the policy's source. Out: a JSON document, a
record; and, from such a file, the episode, and whether it is the recorded one, once versions and
contents are checked.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from itertools import zip_longest
from pathlib import Path
from typing import Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
)

from flipperctl import __version__, checkpoint
from flipperctl.api import Outcome, Profile, Transition
from flipperctl.checkpoint.document import decode
from flipperctl.config import EnvConfig, EvalConfig, parse, to_dict
from flipperctl.config.identity import content_digest
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.metrics import CORE
from flipperctl.errors import (
    CheckpointError,
    ConfigError,
    RequestError,
    other_format,
)
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.names import names
from flipperctl.evaluation.play import EpisodeDigest, Progress, no_progress
from flipperctl.evaluation.rows import DIGEST, Row, arranged, sampled
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import Decision, play
from flipperctl.rollout.risks import EpisodeRisks
from flipperctl.sim.versions import engine_versions
from flipperctl.text.messages import explain

_FORMAT = 1


class _Frozen(BaseModel):
    """A frozen model that refuses unknown keys, NaN and infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class RecordedPolicy(_Frozen):
    """The policy of an episode: a file by its content, or a controller's settings."""

    label: str = Field(description="name of a shipped policy or controller, or path of a file [-]")
    sha256: str | None = Field(None, description="SHA-256 of the policy's file [-]")
    controller: dict[str, Any] | None = Field(
        None, description="name and settings of a controller [-]"
    )
    files: dict[str, str | None] = Field(
        default_factory=dict, description="SHA-256 of each file that the controller reads [-]"
    )

    @classmethod
    def of(cls, source: PolicySource) -> RecordedPolicy:
        """Describe a policy."""
        if source.checkpoint is not None:
            return cls(label=source.label(), sha256=content_digest(source.checkpoint))
        settings = dict(source.settings or {})
        return cls(label=source.label(), controller=settings, files=_digests(source))

    def find(self, where: Path, replacement: Path | None) -> PolicySource:
        """Return the policy, whose file is ``chosen`` or else the recorded one."""
        if self.controller is not None:
            if replacement is not None:
                raise RequestError(f"{where}: its policy is a controller; leave --checkpoint out")
            settings, drive = dict(self.controller), where.with_suffix(".safetensors")
            if drive.name == Path(settings.get("drives", "")).name:
                settings["drives"] = str(drive)  # beside its record, wherever that lies now
            source = PolicySource(settings=settings, name=self.label)
            if [*_digests(source).values()] != [*self.files.values()]:
                raise CheckpointError(
                    f"{where}: a file that controller {self.label} reads is missing or has another "
                    f"content: {', '.join(self.files)}"
                )
            return source
        advice = "name the policy's file with --checkpoint"
        # A file may have another name or content than when the episode was recorded.
        try:
            file = checkpoint.find(replacement or Path(self.label))
        except CheckpointError as error:
            raise CheckpointError(f"{where}: its policy is missing: {error}; {advice}") from error
        if (digest := content_digest(file)) != self.sha256:
            raise CheckpointError(
                f"{where}: its policy has the SHA-256 {self.sha256}; that of {file} is {digest}; "
                f"{advice}"
            )
        return PolicySource(checkpoint=file)


class EpisodeRecord(_Frozen):
    """One episode of an evaluation."""

    format: Literal[1] = Field(1, description="version of this document [-]")
    policy: RecordedPolicy
    versions: dict[str, str] = Field(description="versions that affect the episode's numbers [-]")
    conditions: dict[str, str] = Field(description="name and hash of the conditions [-]")
    config: dict[str, Any] = Field(description="configuration of the environment [-]")
    evaluation_seed: int = Field(ge=0, description="seed of the evaluation [-]")
    episode: int = Field(ge=0, description="index of the episode in the evaluation [-]")
    seed: int = Field(ge=0, description="seed of the episode [-]")
    outcome: Outcome = Field(description="how the episode ended [-]")
    measures: dict[str, float] = Field(description="measures and sampled values, by name [-]")
    digest: str | None = Field(
        None, description="SHA-256 of the actions and of the poses at 100 Hz [-]"
    )
    risks: tuple[float, ...] | None = Field(
        None, description="risk at each decision, of a policy that tells one [-]"
    )

    @classmethod
    def of(cls, config: EvalConfig, source: PolicySource, row: Row) -> EpisodeRecord:
        """Record an episode of an evaluation."""
        conditions = Conditions.of(config)
        return cls(
            policy=RecordedPolicy.of(source),
            versions=used_versions(config, source),
            conditions={"name": conditions.name, "hash": conditions.hash},
            config=to_dict(config.environment()),
            evaluation_seed=config.eval.seed,
            episode=row["episode"],
            seed=row["seed"],
            outcome=row["outcome"],
            measures=measures(row),
            digest=row.get(DIGEST),
            risks=risks(row),
        )

    @model_serializer(mode="wrap")
    def _without_risks(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit the risks of a policy that tells none."""
        return {n: v for n, v in serialize(self).items() if n != "risks" or v is not None}

    def evaluation(self, where: Path) -> EvalConfig:
        """Return the configuration of the evaluation, checked against the recorded conditions."""
        try:
            whole = parse(EnvConfig, self.config)
        except ConfigError as error:
            raise RequestError(f"{where}: its configuration is not valid here: {error}") from error
        sections = {name: getattr(whole, name) for name in EnvConfig.model_fields}
        numbers = {"seed": self.evaluation_seed, "episodes": self.episode + 1}
        config = EvalConfig(**sections, conditions=self.conditions["name"], eval=numbers)
        actual = Conditions.of(config).hash
        if actual != self.conditions["hash"]:
            raise RequestError(
                f"{where}: its conditions have the hash {self.conditions['hash']}, here {actual}: "
                "a file that the ground is read from, or the defaults of a plugin, have changed"
            )
        return config

    def check_versions(self, where: Path, here: Mapping[str, str]) -> None:
        """Check that the versions that affect the episode's numbers are the recorded ones."""
        changed = [name for name in self.versions if here.get(name) != self.versions[name]]
        if changed:
            recorded = ", ".join(f"{name} {self.versions[name]}" for name in changed)
            actual = ", ".join(f"{name} {here.get(name, '–')}" for name in changed)
            raise RequestError(
                f"{where}: it was recorded with {recorded}; here is {actual}, whose episodes may "
                "differ; install the recorded versions to replay it"
            )


def measures(row: Row) -> dict[str, float]:
    """Return the numbers of an episode that a replay must repeat, by name in SI units."""
    return {name: row[name] for name in CORE} | sampled(row)


def risks(row: Row) -> tuple[float, ...] | None:
    """Return the risk at each decision; None of a policy that tells none."""
    risks_of_row = EpisodeRisks.pop(dict(row))
    return None if risks_of_row is None else risks_of_row.values


def used_versions(config: EnvConfig, source: PolicySource) -> dict[str, str]:
    """Return the versions of the package and the libraries that affect an episode's numbers."""
    torch = {"torch": version("torch")} if source.checkpoint is not None else {}
    package = {"flipperctl": __version__, "numpy": version("numpy")}
    return {**package, **torch, **engine_versions(config.sim)}


def read_record(path: Path) -> EpisodeRecord:
    """Read a record."""
    try:
        document = decode(path.read_text(encoding="utf-8"))
        number = document.get("format", _FORMAT) if isinstance(document, dict) else _FORMAT
        if number != _FORMAT:
            raise RequestError(f"{path}: {other_format(number, _FORMAT)}")
        return EpisodeRecord(**document)
    except OSError as error:
        raise RequestError(f"{path}: it cannot be read: {error.strerror}") from error
    except ValidationError as error:
        text = explain(error, "", EpisodeRecord)
        raise RequestError(f"{path}: it is no record of an episode: {text}") from error
    except (ValueError, TypeError) as error:
        raise RequestError(f"{path}: it is no record of an episode: {error}") from error


def _digests(source: PolicySource) -> dict[str, str | None]:
    """Return the SHA-256 of each file that a controller names, None for one that is missing."""
    digests: dict[str, str | None] = {}
    for name in source.controller().uses().values():
        try:
            digests[name] = content_digest(checkpoint.find(Path(name)))
        except CheckpointError:
            digests[name] = None
    return digests


@dataclass(frozen=True)
class Replay:
    """An episode that was played again."""

    record: EpisodeRecord
    config: EvalConfig
    source: PolicySource
    episode: Row
    transitions: tuple[Transition, ...]
    profile: Profile

    @property
    def differences(self) -> list[str]:
        """What differs from the record; empty if the episode is bit-identical."""
        # Measures, the digest of all poses, and the first risk that differs
        recorded, episode, numbers = self.record, self.episode, measures(self.episode)
        pairs: dict[str, Any] = {"outcome": (episode["outcome"], str(recorded.outcome))}
        pairs |= {name: (numbers.get(name), value) for name, value in recorded.measures.items()}
        if recorded.digest is not None:
            pairs["digest"] = episode[DIGEST], recorded.digest
        lines = [f"{name} {us} ({it})" for name, (us, it) in pairs.items() if us != it]
        if recorded.risks is not None:
            risk_pairs = zip_longest(risks(episode) or (), recorded.risks)
            lines += [
                f"risk {t}: {us} ({it})" for t, (us, it) in enumerate(risk_pairs) if us != it
            ][:1]
        return lines

    @property
    def title(self) -> str:
        """One line about the episode: policy, terrain, conditions, index and outcome."""
        record = self.record
        conditions = f"{record.conditions['name']} {record.conditions['hash']}"
        (policy,) = names([record.policy.label]).values()
        return (
            f"{policy} on {self.config.terrain.title}, conditions {conditions}, "
            f"episode {record.episode}: {self.episode['outcome']}"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "controller": self.record.policy.label,
            "terrain": self.config.terrain.title,
            "conditions": dict(self.record.conditions),
            "episode": self.record.episode,
            "seed": self.record.seed,
            "outcome": self.episode["outcome"],
            "measures": measures(self.episode),
            "digest": self.episode[DIGEST],
            "identical": not self.differences,
            "differences": self.differences,
        }


def replay(path: Path, checkpoint: Path | None = None, progress: Progress = no_progress) -> Replay:
    """Play the episode of a record; ``checkpoint`` replaces the path of its policy."""
    record = read_record(path)
    # The package first, since its policies and settings need not be known here.
    record.check_versions(path, {**record.versions, "flipperctl": __version__})
    source = record.policy.find(path, checkpoint)
    config = record.evaluation(path)
    record.check_versions(path, used_versions(config, source))
    environment = config.environment()
    env, policy = FlipperEnv(config=environment), source.build(environment)
    digest, transitions = EpisodeDigest(), list[Transition]()

    def watch(decision: Decision) -> None:
        digest.add(decision)
        transitions.append(decision.transition)

    with progress(f"{config.terrain.title}, replay", 1) as report:
        row = play(env, policy, record.seed, watch=watch, report_progress=report)
    episode = arranged({"episode": record.episode, **row}) | {DIGEST: digest.hexdigest()}
    return Replay(record, config, source, episode, tuple(transitions), env.profile)
