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

from flipperctl.api import DrawingWorld, Profile, Transition
from flipperctl.config import EvalConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.evaluation.episode_record import EpisodeRecord, measures, read_record, risks
from flipperctl.evaluation.play import Progress, no_progress
from flipperctl.evaluation.rows import DIGEST, Row, arranged
from flipperctl.evaluation.workers import EpisodeDigest
from flipperctl.files import check_output, write_json
from flipperctl.policies.source import PolicySource
from flipperctl.results import ResultFolder, result_folder
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
        recorded, episode = self.record, self.episode
        found = []
        if episode["outcome"] != recorded.outcome:
            found.append(f"outcome {episode['outcome']} ({recorded.outcome})")
        ours = measures(episode)
        found += [
            f"{name} {ours.get(name)} ({value})"
            for name, value in recorded.measures.items()
            if ours.get(name) != value
        ]
        if recorded.digest is not None and episode[DIGEST] != recorded.digest:
            found.append(f"digest {episode[DIGEST]} ({recorded.digest})")
        if recorded.risks is not None:
            pairs = zip_longest(risks(episode) or (), recorded.risks)
            found += [f"risk {t}: {us} ({it})" for t, (us, it) in enumerate(pairs) if us != it][:1]
        return found

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
    """Play the episode of a record; ``checkpoint`` replaces the path of its policy.

    Raises:
        RequestError: the file is no record, its versions, conditions or plugins differ from those
            here, or its policy is missing or has another content.
        FlipperctlError: the policy failed.
    """
    record = read_record(path)
    record.check_package(path)
    source = record.policy.find(path, checkpoint)
    config = record.evaluation(path)
    record.check_versions(path, source, config)
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
        folder: ResultFolder | None = None
        if film is not None:
            from flipperctl.figures.film import FILM

            check_output(film, FILM)
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
    states = [found.transitions[0].before, *(t.after for t in found.transitions)]
    robot, fine = found.transitions[0].robot, samples(found.transitions)
    figure = episode_figure(states, found.profile, robot, title(found), samples=fine)
    save(figure, folder / "replay.png")


def _film(path: Path, found: Replay, progress: Progress) -> None:
    from flipperctl.figures.film import film, save_film

    if found.draws:  # the side view does not show why a robot rolls or leaves its heading
        film(found.config, found.source, found.record.seed, path)
        return

    with progress(f"{found.config.terrain.plugin_name}, film", 1) as report:
        made, speed = list(found.transitions), found.config.robot.track_speed
        save_film(path, made, found.profile, made[0].robot, title(found), report, speed=speed)


def title(found: Replay) -> str:
    """Return one line about the episode: policy, terrain, conditions, index and outcome."""
    record = found.record
    conditions = f"{record.conditions['name']} {record.conditions['hash']}"
    return (
        f"{record.policy.label} on {found.config.terrain.plugin_name}, conditions {conditions}, "
        f"episode {record.episode}: {found.episode['outcome']}"
    )


def lines(found: Replay) -> Iterator[str]:
    """Yield outcome and measures of the episode, and whether it is bit-identical."""
    episode = found.episode
    yield title(found)
    yield (
        f"{episode['decisions']} decisions, {episode['t_cost']:.2f} s, pitch variation "
        f"{episode['pitch_variation_100hz']:.3f} rad, largest pitch {episode['max_pitch']:.3f} rad"
    )
    if found.record.digest is None and not found.differences:
        yield "equal to the recorded episode by its measures; it has no digest of the poses"
    elif not found.differences:
        yield f"bit-identical to the recorded episode, digest {episode[DIGEST]:.16}…"
