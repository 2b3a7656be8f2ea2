"""Records the episodes of a training, so that others can learn from them (``train.record``).

In: the steps of the training. Out: with each checkpoint, a file of the episodes that have ended
since the previous one; when the run ends or is stopped, one file of all episodes.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from flipperctl.checkpoint import recording
from flipperctl.checkpoint.recording import RecordedEpisode
from flipperctl.config import TrainConfig
from flipperctl.files import make_folder
from flipperctl.rollout.episode import EpisodeRecorder
from flipperctl.rollout.steps import Step

EPISODES = Path("episodes.safetensors")
"""File of a run directory with all episodes of the training, written when the run ends."""
PARTS = Path("episodes")
"""Folder of a run directory with the files written with its checkpoints since the run started."""


class TrainingRecorder:
    """Writes the episodes of a training, each once until the run ends.

    A file in the folder ``episodes`` is named after the number of its first episode, counted from
    0. It is written before the checkpoint that counts its episodes, so that a checkpoint never
    counts missing episodes. Episodes that no checkpoint counts are played and written again when
    the run is resumed.
    """

    def __init__(self, config: TrainConfig, directory: Path) -> None:
        """Create a recorder, which does nothing unless ``train.record`` is set."""
        self._config, self._directory = config, directory
        self._on, self._size = config.train.record, config.perception.size
        self._running, self._new = EpisodeRecorder(), list[RecordedEpisode]()

    def add(self, step: Step, number: int) -> None:
        """Add a step of episode ``number``, counted from 0."""
        if not self._on:
            return
        newest = slice(-self._size, None)  # of the frames in the network's input
        self._running.add(
            step.observation[newest],
            step.action,
            step.reward,
            step.next_observation[newest],
            step.label if self._config.teacher.teaches else None,
        )
        if step.ending is not None:
            self._new.append(self._running.finish(number, step.ending))

    def drop(self) -> None:
        """Discard the running episode."""
        self._running.drop()

    def save(self) -> None:
        """Write the episodes that have ended since the last call, completely or not at all."""
        if self._new:
            folder = make_folder(self._directory / PARTS)
            self._write(folder / f"{self._new[0].number:08}.safetensors", self._new)
            self._new = []

    def finish(self) -> None:
        """Write all episodes into one file and remove the files of the checkpoints."""
        if not self._on:
            return
        self.save()
        parts = self._parts()
        if parts or not (self._directory / EPISODES).is_file():
            self._write(self._directory / EPISODES, list(self._saved()))
        self._remove(parts)

    def restore(self, episodes: int) -> None:
        """Continue after the first ``episodes``; drop later ones, which are played again."""
        if not self._on:
            return
        whole = self._directory / EPISODES
        self._remove([part for part in self._parts() if int(part.stem) >= episodes])
        if episodes == 0:
            whole.unlink(missing_ok=True)
            return
        saved = list(self._saved())
        if saved and saved[-1].number >= episodes:  # from after the restored checkpoint
            self._write(whole, [episode for episode in saved if episode.number < episodes])
            self._remove(self._parts())

    def _parts(self) -> list[Path]:
        """Return the files of the checkpoints in the order of their episodes."""
        found = (self._directory / PARTS).glob("*.safetensors")
        return sorted((path for path in found if path.stem.isdecimal()), key=lambda p: int(p.stem))

    def _saved(self) -> Iterator[RecordedEpisode]:
        """Yield each written episode once, in order."""
        whole, last = self._directory / EPISODES, -1
        for path in [*([whole] if whole.is_file() else []), *self._parts()]:
            for episode in recording.read(path).episodes:
                if episode.number > last:  # the run may have been killed after joining it
                    last = episode.number
                    yield episode

    def _write(self, path: Path, episodes: list[RecordedEpisode]) -> None:
        driver = f"training on {self._config.terrain.plugin_name}"
        recording.write(path, driver, [(self._config, episodes)])

    def _remove(self, parts: list[Path]) -> None:
        for part in parts:
            part.unlink()
        folder = self._directory / PARTS
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
