"""Drives of people and scripts: files that are played again bit for bit, and studies of several.

In: a scene, a policy that commands flippers and belts, a folder. Out: for each drive an episode
file, by which ``operator`` repeats it and from which a policy learns, and its record for
``flipperctl replay``.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from flipperctl.api import Policy
from flipperctl.checkpoint import recording
from flipperctl.checkpoint.recording import RecordedEpisode, drive_files
from flipperctl.config import EvalConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import RequestError
from flipperctl.evaluation.play import EpisodeDigest
from flipperctl.evaluation.replay import EpisodeRecord
from flipperctl.evaluation.rows import DIGEST, Row, arranged
from flipperctl.files import write_json
from flipperctl.policies.controllers import from_action
from flipperctl.policies.operator import Operator
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import Decision, EpisodeRecorder, EvaluationSeeds, play


class DriveFolder:
    """The drives of one operator."""

    def __init__(self, path: Path, driver: str) -> None:
        """``driver``: who drives, such as ``person: anna`` or ``script: slow``."""
        self.path, self.driver = path, driver
        if path.exists() and not path.is_dir():
            raise RequestError(f"--output {path}: it is a file; a folder for drives is allowed")
        for file in drive_files(path):
            theirs = recording.read(file).document.driver
            if theirs != driver:
                raise RequestError(
                    f"--output {path}: it holds drives of {theirs!r}, not of {driver!r}; a folder "
                    "holds the drives of one operator"
                )

    def check(self, config: EvalConfig) -> None:
        """Check that the drives that the folder holds have the settings of further ones."""
        Operator(drives=str(self.path)).check(config)

    def file(self, config: EvalConfig, seed: int) -> Path:
        """Return the file of a drive on the draw with this seed."""
        return self.path / f"drive_{config.terrain.plugin_name}_{seed}.safetensors"

    def missing(self, config: EvalConfig, first: int, count: int) -> list[int]:
        """Return those of the episodes from ``first`` on that were not driven yet."""
        seeds = EvaluationSeeds.of(config.eval.seed, config.terrain)
        wanted = range(first, first + count)
        return [i for i in wanted if not self.file(config, seeds(i)).exists()]

    def drive(
        self,
        config: EvalConfig,
        env: FlipperEnv,
        policy: Policy,
        index: int,
        *,
        watch: Callable[[Decision], None] = lambda decision: None,
        keep: bool = True,
    ) -> Row:
        """Let an operator drive an episode; return its row.

        ``policy`` has ``command_period`` and ``command``; see ``flipperctl.api.Policy``. The files
        are written once the episode has ended, or not at all; ``keep``: whether they are.
        """
        seed = EvaluationSeeds.of(config.eval.seed, config.terrain)(index)
        recorder, digest = EpisodeRecorder(), EpisodeDigest()

        def seen(d: Decision) -> None:
            before, after = d.perception.observation, d.next_perception.observation
            label = from_action(d.action)
            recorder.add(before, d.action, d.reward, after, label, d.transition.commands)
            digest.add(d)
            watch(d)

        ending = play(env, policy, seed, watch=seen)
        row = arranged({"episode": index, **ending}) | {DIGEST: digest.hexdigest()}
        if keep:
            self._write(config, recorder.finish(index, ending), row, policy)
        return row

    def _write(
        self, config: EvalConfig, episode: RecordedEpisode, row: Row, policy: Policy
    ) -> None:
        self.path.mkdir(parents=True, exist_ok=True)
        file = self.file(config, episode.seed)
        period = getattr(policy, "command_period", None)
        recording.write(file, self.driver, [(config, [episode])], period)
        source = PolicySource(settings={"name": "operator", "drives": str(file)})
        record = EpisodeRecord.of(config, source, row)
        write_json(file.with_suffix(".json"), record.model_dump(mode="json"))
