"""Play a recorded episode again, and compare it with its record bit for bit.

In: the file of a record. Out: the episode, and whether it is the recorded one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

from flipperctl import __version__
from flipperctl.api import DrawingWorld, Profile, Transition
from flipperctl.config import EvalConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.evaluation.episode_record import (
    EpisodeRecord,
    measures,
    read_record,
    risks,
    used_versions,
)
from flipperctl.evaluation.play import Progress, no_progress
from flipperctl.evaluation.rows import DIGEST, Row, arranged
from flipperctl.evaluation.workers import EpisodeDigest
from flipperctl.files import check_output, write_json
from flipperctl.policies.source import PolicySource
from flipperctl.results import result_folder
from flipperctl.rollout.episode import Decision, play

NAMES = ("replay.json", "replay.png")


@dataclass(frozen=True)
class Replay:
    """An episode that was played again."""

    record: EpisodeRecord
    config: EvalConfig
    source: PolicySource
    episode: Row
    transitions: tuple[Transition, ...]
    profile: Profile
    draws: bool = False
    """Whether the engine draws pictures of its own."""

    @property
    def differences(self) -> list[str]:
        """What differs from the record; empty if the episode is bit-identical."""
        recorded, episode, ours = self.record, self.episode, measures(self.episode)
        pairs: dict[str, Any] = {"outcome": (episode["outcome"], str(recorded.outcome))}
        pairs |= {name: (ours.get(name), value) for name, value in recorded.measures.items()}
        if recorded.digest is not None:
            pairs["digest"] = episode[DIGEST], recorded.digest
        found = [f"{name} {us} ({it})" for name, (us, it) in pairs.items() if us != it]
        if recorded.risks is not None:
            told = zip_longest(risks(episode) or (), recorded.risks)
            found += [f"risk {t}: {us} ({it})" for t, (us, it) in enumerate(told) if us != it][:1]
        return found

    @property
    def title(self) -> str:
        """One line about the episode: policy, terrain, conditions, index and outcome."""
        record = self.record
        conditions = f"{record.conditions['name']} {record.conditions['hash']}"
        return (
            f"{record.policy.label} on {self.config.terrain.plugin_name}, conditions {conditions}, "
            f"episode {record.episode}: {self.episode['outcome']}"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "controller": self.record.policy.label,
            "terrain": self.config.terrain.plugin_name,
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

    with progress(f"{config.terrain.plugin_name}, replay", 1) as report:
        row = play(env, policy, record.seed, watch=watch, report_progress=report)
    episode = arranged({"episode": record.episode, **row}) | {DIGEST: digest.hexdigest()}
    draws = isinstance(env.drive.world, DrawingWorld)
    return Replay(record, config, source, episode, tuple(transitions), env.profile, draws)


def replay_file(
    path: Path,
    checkpoint: Path | None,
    output: Path | None,
    film: Path | None,
    *,
    progress: Progress = no_progress,
    tell: Callable[[str], None] = lambda text: None,
) -> Replay:
    """Return the episode of a record after writing its files; see ``replay``.

    ``tell`` is called with a line for each output.

    Raises:
        RequestError: the episode cannot be played here, or a path cannot be written.
        FlipperctlError: the policy failed, or a file could not be written.
    """
    with ExitStack() as stack:
        if film is not None:
            from flipperctl.figures.film import FILM

            check_output(film, FILM)
        folder = None
        if output is not None:
            folder = stack.enter_context(result_folder(output, "replay", NAMES))
        found = replay(path, checkpoint, progress)
        if folder is not None:
            folder.replace(lambda part: _write(part, found))
            tell(f"wrote {' and '.join(NAMES)} to {folder.path}")
        if film is not None:
            _film(film, found, progress)
            tell(f"wrote {film}")
    return found


def _write(folder: Path, found: Replay) -> None:
    from flipperctl.figures.episode import episode_figure
    from flipperctl.figures.figure import save
    from flipperctl.figures.film import samples

    write_json(folder / "replay.json", found.to_dict())
    made = found.transitions
    states = [made[0].before, *(t.after for t in made)]
    drawn = episode_figure(states, found.profile, made[0].robot, found.title, samples=samples(made))
    save(drawn, folder / "replay.png")


def _film(path: Path, found: Replay, progress: Progress) -> None:
    from flipperctl.figures.film import film, save_film

    if found.draws:  # the side view does not show why a robot rolls or leaves its heading
        film(found.config, found.source, found.record.seed, path)
        return
    made, speed = list(found.transitions), found.config.robot.track_speed
    with progress(f"{found.config.terrain.plugin_name}, film", 1) as report:
        save_film(path, made, found.profile, made[0].robot, found.title, report, speed=speed)


def lines(found: Replay) -> Iterator[str]:
    """Yield outcome and measures of the episode, and whether it is bit-identical."""
    episode = found.episode
    yield found.title
    yield (
        f"{episode['decisions']} decisions, {episode['t_cost']:.2f} s, pitch variation "
        f"{episode['pitch_variation_100hz']:.3f} rad, largest pitch {episode['max_pitch']:.3f} rad"
    )
    if not found.differences:
        digest = f"bit-identical to the recorded episode, digest {episode[DIGEST]:.16}…"
        none = "equal to the recorded episode by its measures; it has no digest of the poses"
        yield none if found.record.digest is None else digest
