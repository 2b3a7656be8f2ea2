"""A small file with all that is needed to play one episode again, bit for bit.

In: an episode of an evaluation, its configuration and the policy's source. Out: a JSON document;
and, from such a file, the configuration and the policy, once versions and contents are checked.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
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
from flipperctl.api import Outcome
from flipperctl.checkpoint.sealed import decode
from flipperctl.config import EnvConfig, EvalConfig, parse, to_dict
from flipperctl.config.identity import content_digest
from flipperctl.env.metrics import CORE
from flipperctl.errors import CheckpointError, ConfigError, RequestError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.rows import DIGEST, Row, sampled
from flipperctl.messages import explain
from flipperctl.policies.identity import named_files
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import EpisodeRisks
from flipperctl.sim.versions import engine_versions

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

    def find(self, where: Path, chosen: Path | None) -> PolicySource:
        """Return the policy, whose file is ``chosen`` or else the recorded one."""
        if self.controller is not None:
            if chosen is not None:
                raise RequestError(f"{where}: its policy is a controller; leave --checkpoint out")
            source = PolicySource(settings=self.controller)
            if _digests(source) != self.files:
                raise CheckpointError(
                    f"{where}: a file that controller {self.label} reads is missing or has another "
                    f"content: {', '.join(self.files)}"
                )
            return source
        advice = "name the policy's file with --checkpoint"
        try:
            file = checkpoint.find(chosen or Path(self.label))
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
        found = Conditions.of(config).hash
        if found != self.conditions["hash"]:
            raise RequestError(
                f"{where}: its conditions have the hash {self.conditions['hash']}, here {found}: a "
                "file that the ground is read from, or the defaults of a plugin, have changed"
            )
        return config

    def check_versions(self, where: Path, here: Mapping[str, str]) -> None:
        """Check that the versions that affect the episode's numbers are the recorded ones."""
        changed = [name for name in self.versions if here.get(name) != self.versions[name]]
        if changed:
            recorded = ", ".join(f"{name} {self.versions[name]}" for name in changed)
            found = ", ".join(f"{name} {here.get(name, '–')}" for name in changed)
            raise RequestError(
                f"{where}: it was recorded with {recorded}; here is {found}, whose episodes may "
                "differ; install the recorded versions to replay it"
            )


def measures(row: Row) -> dict[str, float]:
    """Return the numbers of an episode that a replay must repeat, by name in SI units."""
    return {name: row[name] for name in CORE} | sampled(row)


def risks(row: Row) -> tuple[float, ...] | None:
    """Return the risk at each decision; None of a policy that tells none."""
    found = EpisodeRisks.pop(dict(row))
    return None if found is None else found.told


def used_versions(config: EnvConfig, source: PolicySource) -> dict[str, str]:
    """Return the versions of the package and the libraries that affect an episode's numbers."""
    torch = {"torch": version("torch")} if source.checkpoint is not None else {}
    own = {"flipperctl": __version__, "numpy": version("numpy")}
    return {**own, **torch, **engine_versions(config.sim)}


def read_record(path: Path) -> EpisodeRecord:
    """Read a record."""
    try:
        document = decode(path.read_text(encoding="utf-8"))
        number = document.get("format", _FORMAT) if isinstance(document, dict) else _FORMAT
        if number != _FORMAT:
            raise RequestError(
                f"{path}: its format is {number!r}; this version of flipperctl, {__version__}, "
                f"reads format {_FORMAT}"
            )
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
    found: dict[str, str | None] = {}
    for _, name in named_files(source.controller()):
        try:
            found[name] = content_digest(checkpoint.find(Path(name)))
        except CheckpointError:
            found[name] = None
    return found
