"""The benchmark: frozen scenes with fixed prices, and scores relative to each scene's best rule.

In: a file of scenes, and the episodes of a method's policies and of the rules on them. Out: a
result file that others can verify. A scene's score is the mean cost of the policy's episodes as a
fraction of the rule's: the pitch variation of a crossing, on some tracks with the roll's, or the
scene's price for a failure. No other method has a part in it. The seeds of an edition follow from
its salt.
"""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_serializer

from flipperctl.api import FloatArray, Outcome, Robot
from flipperctl.config import strict_yaml
from flipperctl.config.presets import presets
from flipperctl.config.resolver import parse
from flipperctl.core.targets import Flippers
from flipperctl.errors import ConfigError, RequestError
from flipperctl.evaluation.evaluate import Result
from flipperctl.evaluation.rows import DIGEST, Episodes
from flipperctl.evaluation.seeds import mean_interval
from flipperctl.evaluation.statistics import Interval
from flipperctl.evaluation.store import versions_here
from flipperctl.policies.identity import PolicyIdentity
from flipperctl.text.messages import unknown

MEASURE, ROLL = "pitch_variation_100hz", "roll_variation_100hz"
"""Measures of a crossing's cost; the second where a track says so [rad]."""
_DIGITS = 16  # hexadecimal digits of the hashes in a file


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Scene(_Frozen):
    """Ground and conditions that are played with seeds of their own."""

    words: str = Field(description="settings, as key=value [-]")
    strongest: str = Field(description="rule whose mean cost is 1 [-]")
    price: float = Field(gt=0, description="cost of an episode that is not reached [rad]")


class Track(_Frozen):
    """Scenes that make one score."""

    episodes: int = Field(ge=5, description="episodes of each scene [-]")
    flippers: Flippers = Field("pairs", description="flippers of the robot [-]")
    rolls: bool = Field(False, description="a crossing costs its roll variation, too [-]")
    scenes: dict[str, Scene] = Field(min_length=1)


class Benchmark(_Frozen):
    """A version of the benchmark. Any change of its file makes another version."""

    name: str = ""
    """Name of the version, which is that of its file."""
    about: str
    tracks: dict[str, Track] = Field(min_length=1)

    def digest(self, tracks: Iterable[str]) -> str:
        """Return a hash of what is played on some tracks: scenes, seeds, episodes and rules.

        Prices are not part of it, since a result file states episodes and no scores.
        """
        played = [[s.label, s.words, s.scene.strongest] for s in self.sections(tracks)]
        return _hash([self.name, played])

    def tracks_for(self, robots: Iterable[Robot | None]) -> list[str]:
        """Return the tracks that policies for these robots play; None stands for any robot."""
        flippers = {robot.flippers for robot in robots if robot is not None}
        chosen = [name for name, track in self.tracks.items() if flippers <= {track.flippers}]
        if not chosen:
            raise RequestError("policies for pairs and for four flippers have no track in common")
        return chosen

    def sections(self, tracks: Iterable[str], salt: str = "") -> list[Section]:
        """Return the scenes of some tracks, or of all without any, with the seeds of an edition.

        The public edition has an empty ``salt``.
        """
        chosen = list(tracks)
        for name in chosen:
            if name not in self.tracks:
                raise RequestError(unknown("--track: there is no track", name, self.tracks))
        return [
            Section(track, name, scene, self._words(track, name, salt))
            for track, content in self.tracks.items()
            if track in (chosen or self.tracks)
            for name, scene in content.scenes.items()
        ]

    def _words(self, track: str, name: str, salt: str) -> tuple[str, ...]:
        content = self.tracks[track]
        seed = int(_hash([self.name, salt, track, name])[:7], 16)
        numbers = f"eval.seed={seed}", f"eval.episodes={content.episodes}"
        return *shlex.split(content.scenes[name].words), *numbers


class Section(NamedTuple):
    """A scene of a track, as it is played."""

    track: str
    name: str
    scene: Scene
    words: tuple[str, ...]
    """Its settings, and the seed and number of its episodes, as ``key=value``."""

    @property
    def label(self) -> str:
        """Name among the scenes of all tracks."""
        return f"{self.track}: {self.name}"


def find_benchmark(name: str) -> Benchmark:
    """Return a version of the benchmark by its name."""
    known = presets("benchmark")
    if name not in known:
        raise ConfigError(unknown("benchmark: there is no version", name, known))
    where = f"benchmark {name}"
    return parse(Benchmark, strict_yaml.read(known[name], where), where).model_copy(
        update={"name": name}
    )


def edition(salt: str) -> str:
    """Return what a result file states of its edition: a hash of the salt, or ``public``."""
    return _hash(["edition", salt]) if salt else "public"


def _hash(document: object) -> str:
    text = json.dumps(document, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]


class PlayedEpisodes(_Frozen):
    """The episodes of one policy on a scene, in their order."""

    outcomes: tuple[Outcome, ...]
    pitch_variation_100hz: tuple[float | None, ...]
    """θ̂_R at 100 Hz [rad]."""
    digests: tuple[str, ...]
    """Beginnings of the SHA-256 of all actions and poses."""
    roll_variation_100hz: tuple[float | None, ...] = ()
    """Of tracks that count it [rad]."""

    @model_serializer(mode="wrap")
    def _without_what_no_track_counts(self, dump: Any) -> dict[str, Any]:
        # Files of the other tracks, and their hashes, are those of before.
        return {name: value for name, value in dump(self).items() if value or name != ROLL}

    @classmethod
    def of(cls, episodes: Episodes, *, rolls: bool) -> Self:
        """Take what counts from rows of episodes; see ``Track.rolls``."""
        return cls(
            outcomes=tuple(row["outcome"] for row in episodes),
            pitch_variation_100hz=tuple(row[MEASURE] for row in episodes),
            digests=tuple(row[DIGEST][:_DIGITS] for row in episodes),
            roll_variation_100hz=tuple(row[ROLL] for row in episodes) if rolls else (),
        )

    def sizes(self, *, rolls: bool) -> set[int]:
        """Return the numbers of outcomes, costs and digests."""
        names = {*type(self).model_fields} - ({ROLL} if not rolls else set())
        return {len(getattr(self, name)) for name in names}

    def costs(self, price: float) -> FloatArray:
        """Return the cost of each episode, (E,) [rad]."""
        reached = [outcome == Outcome.REACHED for outcome in self.outcomes]
        values = np.array(self.pitch_variation_100hz, dtype=float)
        if self.roll_variation_100hz:
            values += np.array(self.roll_variation_100hz, dtype=float)
        return np.where(reached, np.minimum(values, price), price)


class SceneResult(_Frozen):
    """What a method and the scene's rule did on equal episodes."""

    track: str
    scene: str
    policies: tuple[PlayedEpisodes, ...]
    """Of each training seed, in the order of ``BenchmarkResult.policies``."""
    rule: PlayedEpisodes

    def ratios(self, price: float) -> FloatArray:
        """Return numbers whose mean is the ratio of the mean costs, (S, E).

        The ratio is linearised about its value, so that they vary as it does (delta method).
        """
        costs = np.array([policy.costs(price) for policy in self.policies])
        rule = self.rule.costs(price)
        ratio = costs.mean(axis=1, keepdims=True) / rule.mean()
        linear: FloatArray = ratio + (costs - ratio * rule) / rule.mean()
        return linear


class PolicyEntry(_Frozen):
    """A policy of a method."""

    label: str
    digest: str
    """Hash of its content, as stored episodes have it."""
    training_seed: int | None = None

    @classmethod
    def of(cls, policy: PolicyIdentity) -> Self:
        """Take what a result file states of a policy."""
        return cls(label=policy.label, digest=policy.digest, training_seed=policy.training_seed)


class BenchmarkResult(_Frozen):
    """A method's result file, without times or machines: equal plays give equal files."""

    format: Literal[1] = 1
    benchmark: str
    """Name of the version."""
    scenes_hash: str
    """Hash of the tracks that were played; see ``Benchmark.digest``."""
    edition: str
    method: str
    policies: tuple[PolicyEntry, ...]
    versions: dict[str, str]
    scenes: tuple[SceneResult, ...]
    content_hash: str = ""
    """Hash of everything else in the file."""

    def sealed(self) -> Self:
        """Return the result with the hash of its content."""
        return self.model_copy(update={"content_hash": self._content()})

    def _content(self) -> str:
        return _hash(self.model_dump(mode="json", exclude={"content_hash"}))

    def check(self, where: Path, benchmark: Benchmark) -> None:
        """Refuse a file that was changed, leaves episodes out, or belongs to other scenes."""
        if self.benchmark != benchmark.name:
            raise RequestError(f"{where}: it is of version {self.benchmark}; give its --version")
        if self.content_hash != self._content():
            raise RequestError(f"{where}: its content was changed after it was written")
        tracks = {part.track: None for part in self.scenes}
        if self.scenes_hash != benchmark.digest(tracks):
            raise RequestError(f"{where}: its scenes are not those of benchmark {self.benchmark}")
        # Whole tracks alone make a score: every scene, every policy, every episode
        wanted = [(section.track, section.name) for section in benchmark.sections(tracks)]
        whole = wanted == [(part.track, part.scene) for part in self.scenes]
        for part in self.scenes if whole else ():
            track, played = benchmark.tracks[part.track], (*part.policies, part.rule)
            sizes = [episodes.sizes(rolls=track.rolls) for episodes in played]
            whole &= sizes == [{track.episodes}] * (len(self.policies) + 1)
        if not whole:
            raise RequestError(f"{where}: it lacks some of the episodes of its tracks")


def read_result(file: Path) -> BenchmarkResult:
    """Read a result file."""
    try:
        document = json.loads(file.read_bytes())
    except OSError as error:
        raise RequestError(f"{file}: it cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise RequestError(f"{file}: it is no result of a benchmark: {error}") from error
    return parse(BenchmarkResult, document, str(file))


def results_of(
    benchmark: Benchmark, salt: str, sections: Sequence[Section], result: Result
) -> list[BenchmarkResult]:
    """Return the result file of each method from the episodes of policies and rules."""
    methods = dict.fromkeys(p.entry.method for p in result.played if not p.entry.is_baseline)
    files = []
    for method in methods:
        scenes, policies, versions = [], list[PolicyEntry](), dict[str, str]()
        for section in sections:
            rolls = benchmark.tracks[section.track].rolls
            here = [p for p in result.played if p.entry.scene == section.label]
            (rule,) = (p for p in here if p.entry.is_baseline)
            of_method = [p for p in here if p.entry.method == method and p is not rule]
            scenes.append(
                SceneResult(
                    track=section.track,
                    scene=section.name,
                    policies=tuple(PlayedEpisodes.of(p.episodes, rolls=rolls) for p in of_method),
                    rule=PlayedEpisodes.of(rule.episodes, rolls=rolls),
                )
            )
            # The policies are the same on every scene, and so is the code that plays them.
            policies = [PolicyEntry.of(p.policy) for p in of_method if p.policy is not None]
            versions |= versions_here(rule.entry.config)
        file = BenchmarkResult(
            benchmark=benchmark.name,
            scenes_hash=benchmark.digest({section.track: None for section in sections}),
            edition=edition(salt),
            method=method,
            policies=tuple(policies),
            versions=versions,
            scenes=tuple(scenes),
        )
        files.append(file.sealed())
    return files


@dataclass(frozen=True)
class Score:
    """The score of a track or of a scene, and what it is made of."""

    ratio: Interval
    """Cost as a fraction of the rule's; below 1 is better."""
    success: float
    """Fraction of the episodes that were reached, 0 to 1."""
    rule: str
    """The rule of a scene; empty for a track."""


def scores(result: BenchmarkResult, benchmark: Benchmark) -> dict[tuple[str, str], Score]:
    """Return the score of each track, under an empty scene, and of its scenes."""
    table: dict[tuple[str, str], Score] = {}
    for track, played in _by_track(result.scenes).items():
        ratios: dict[str, FloatArray] = {}
        successes: list[float] = []
        for part in played:
            scene = benchmark.tracks[track].scenes[part.scene]
            ratios[part.scene] = part.ratios(scene.price)
            outcomes = [outcome for policy in part.policies for outcome in policy.outcomes]
            successes.append(float(np.mean([o == Outcome.REACHED for o in outcomes])))
        # A track's score is the mean over its scenes, with seeds and episodes in its interval.
        table[track, ""] = Score(mean_interval(ratios), float(np.mean(successes)), "")
        for (name, values), success in zip(ratios.items(), successes, strict=True):
            rule = benchmark.tracks[track].scenes[name].strongest
            table[track, name] = Score(mean_interval({name: values}), success, rule)
    return table


def _by_track(scenes: Sequence[SceneResult]) -> Mapping[str, list[SceneResult]]:
    tracks: dict[str, list[SceneResult]] = {}
    for scene in scenes:
        tracks.setdefault(scene.track, []).append(scene)
    return tracks


def sample(
    result: BenchmarkResult, share: float, rng: np.random.Generator
) -> Iterator[tuple[SceneResult, list[int]]]:
    """Yield each scene with the episodes that a verification plays again, at least one."""
    for scene in result.scenes:
        count = len(scene.rule.outcomes)
        size = max(1, round(share * count))
        yield scene, sorted(rng.choice(count, size, replace=False).tolist())


def difference(stated: PlayedEpisodes, index: int, row: Mapping[str, Any]) -> str:
    """Return how an episode that was played again differs from a file's; empty if it is equal."""
    now = PlayedEpisodes.of(Episodes((dict(row),)), rolls=bool(stated.roll_variation_100hz))
    changes = [
        f"{name} {getattr(stated, name)[index]}, now {getattr(now, name)[0]}"
        for name in PlayedEpisodes.model_fields
        if getattr(now, name) and getattr(stated, name)[index] != getattr(now, name)[0]
    ]
    return "; ".join(changes)
