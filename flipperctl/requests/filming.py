"""The film of an evaluation: the choice of its episodes and policies.

In: what a user asked for, the plan, and after it was played its result. Out: a film.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from flipperctl.checkpoint import KEPT
from flipperctl.config import TrainConfig
from flipperctl.errors import RequestError
from flipperctl.evaluation.evaluate import Result
from flipperctl.evaluation.names import names
from flipperctl.evaluation.plan import Entry, Plan
from flipperctl.evaluation.play import Progress
from flipperctl.policies.source import load_policy
from flipperctl.rollout.episode import EvaluationSeeds
from flipperctl.text.messages import counted

if TYPE_CHECKING:
    from flipperctl.figures.film import Take

FAILURES = 3
"""Largest number of failed episodes that a film shows [-]."""
_MOST = 6
"""Largest number of policies in a film [-]."""
_CLIPS = 30
"""Largest number of clips in the film of a training [-]."""


@dataclass(frozen=True)
class Filming:
    """A film that a user asked for."""

    path: Path
    episodes: tuple[int, ...] | None = None
    """Indices of the episodes; None: the first failures if ``failures``, else the first one."""
    failures: bool = False
    """Whether the film shows the first episodes that not all policies finished."""
    speed: float | None = None
    """Real time per time of the film [-]; None: ``film.SPEED``."""

    @classmethod
    def asked(
        cls, path: Path | None, episodes: str | None, failures: bool, speed: float | None
    ) -> Filming | None:
        """Return the film that options ask for, if any.

        Raises:
            RequestError: options without ``--film``, or that contradict each other.
        """
        options = {"--episode": episodes, "--failures": failures or None, "--speed": speed}
        if path is None:
            for option, value in options.items():
                if value is not None:
                    hint = "; --episodes is their number" if option == "--episode" else ""
                    raise RequestError(f"{option} is of a film: add --film FILE{hint}")
            return None
        if episodes is not None and failures:
            raise RequestError("--episode and --failures: one of them is allowed")
        numbers = None if episodes is None else tuple(map(_index, episodes.split(",")))
        return cls(path, numbers, failures, speed)

    def check(self, plan: Plan) -> None:
        """Check, before the episodes are played, that the film can be made."""
        from flipperctl.figures.animation import check_film
        from flipperctl.figures.film import samples_per_frame

        check_film(self.path)
        if self.speed is not None:
            samples_per_frame(self.speed)
        if (count := len({entry.ground for entry in plan.entries})) != 1:
            raise RequestError(f"--film shows one scene; {count} are evaluated")
        if len(plan.entries) > _MOST:
            raise RequestError(
                f"--film shows at most {_MOST} policies; {len(plan.entries)} are evaluated"
            )
        last = plan.entries[0].config.eval.episodes - 1
        for index in self.episodes or ():
            if index > last:
                allowed = f"0 to {last}" if last else "only 0"
                raise RequestError(f"--episode {index}: {allowed} is evaluated; see --episodes")

    def make(self, result: Result, progress: Progress, tell: Callable[[str], None]) -> None:
        """Write the film; ``tell`` is called with a line that says so."""
        from flipperctl.figures.film import SPEED, film

        entries = result.plan.entries
        shown: Sequence[int] = self.episodes or (0,)
        # The first failures of any policy, if the film is to show some
        if self.failures:
            failed = sorted(
                {row["episode"] for item in result.rows for row in item.episodes.failed}
            )
            if not (shown := failed[:FAILURES]):
                tell(f"no episode failed: {self.path} is not written")
                return
        takes = [_take(entries, index) for index in shown]
        with progress(f"{entries[0].terrain}, film", 1) as report:
            speed = SPEED if self.speed is None else self.speed
            film(self.path, takes, speed=speed, report_progress=report)
        tell(f"wrote {self.path}")


def check_training_film(path: Path, config: TrainConfig) -> None:
    """Check, before a training, that ``film_training`` can write its film to ``path``."""
    from flipperctl.figures.animation import check_film

    check_film(path)
    if (shown := -(-config.train.decisions // config.train.validate_every)) > _CLIPS:
        raise RequestError(
            f"--film shows at most {_CLIPS} validations, and the training has {shown}; set a "
            "larger train.validate_every"
        )


def film_training(run: Path, config: TrainConfig, path: Path, tell: Callable[[str], None]) -> None:
    """Write a film of the policy at each validation of a run with ``train.keep_policies``.

    All drive the same episode, that of seed 0 of an evaluation, one after the other.
    """
    from flipperctl.figures.film import Part, Take, film

    seed, takes = EvaluationSeeds.of(0, config.terrain)(0), []
    policies = sorted((int(file.stem.split("_")[1]), file) for file in run.glob(KEPT.format("*")))
    for decision, file in policies:
        name = f"after {decision:,} decisions"
        part = Part(name, config.environment(), load_policy(file), seed)
        takes.append(Take(f"{config.terrain.title}, episode 0", [part]))
    tell(f"filming the policies of {counted(len(takes), 'validation')} on one episode …")
    film(path, takes)
    tell(f"wrote {path}")


def _take(entries: Sequence[Entry], index: int) -> Take:
    from flipperctl.figures.film import Part, Take

    first = entries[0]
    seed = EvaluationSeeds.of(first.config.eval.seed, first.config.terrain)(index)
    called = names([entry.named for entry in entries])
    parts = [Part(called[e.named], e.config.environment(), e.source, seed) for e in entries]
    return Take(f"{first.terrain}, episode {index}", parts)


def _index(text: str) -> int:
    if not (text.strip().isdecimal() and text.isascii()):
        raise RequestError(f"--episode {text!r}: numbers from 0 are allowed, as in 7 or 3,7")
    return int(text)
