"""The checks of a learner: a short training learns, is saved, resumed and exported."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ValidationError

from flipperctl.api import Learner, ObservationLayout
from flipperctl.config import TrainConfig, parse
from flipperctl.errors import ConfigError, ExportError, MissingExtraError
from flipperctl.testing.check import NotChecked, of, require
from flipperctl.testing.recorded import SHORT, Ground, NoReward
from flipperctl.text.files import make_folder

if TYPE_CHECKING:
    from flipperctl.training.trainer import Trainer

_SMALL = 16
"""Largest whole number in the settings of a short training, unless a field's bound is above."""
_MORE = 24
"""Decisions of a short training beyond twice those before the first update [-]."""
_MOST = 400
"""Largest number of decisions before the first update of a short training [-]."""


def short(learner: Learner) -> Learner:
    """Return the learner with settings of a short training."""
    cls = type(learner)
    # Sizes and waits are among the whole numbers, which become small within their bounds.
    values = {name: getattr(learner, name) for name in cls.model_fields}
    small: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, int) and not isinstance(value, bool) and value > _SMALL:
            bounds = (getattr(item, "ge", None) for item in cls.model_fields[name].metadata)
            small[name] = max([_SMALL, *(bound for bound in bounds if bound is not None)])
    try:
        return cls(**{**values, **small, **cls.short})
    except (ValidationError, ConfigError) as error:
        raise ConfigError(f"settings of a short training are refused: {error}") from error


def _config(learner: Learner, decisions: int) -> TrainConfig:
    values: dict[str, Any] = {
        "terrain": Ground(points=SHORT.points),
        "rewards": {"none": NoReward()},
        "network": "mlp",
        "actions": learner.drives[0],
        "agent": learner,
        "train": {"mode": "exact", "decisions": decisions, "validation_episodes": 1},
        **SHORT.settings,
    }
    return parse(TrainConfig, values)


def _trainer(config: TrainConfig, folder: Path) -> Trainer:
    from flipperctl import checkpoint
    from flipperctl.training.trainer import Trainer

    make_folder(folder / checkpoint.LAST.parent)
    return Trainer(config, folder)


@of("agent", "trains", everywhere=False)
def trains(learner: Learner) -> None:
    """Check that a training learns when the learner says so, and that its file has its policy.

    One that is stopped and resumed has the same files, bit for bit, and they load as a policy that
    exports to ONNX.
    """
    import torch

    from flipperctl import checkpoint
    from flipperctl.export.policy import compare_onnx
    from flipperctl.policies.trained import policy_module

    learner = short(learner)

    # The first update must come soon, since the check plays two trainings or three.
    first = learner.first_update(_config(learner, _MORE))
    before = 0 if first is None else first[0]
    text = f"its first update is after {before} decisions; its ClassVar short can make it sooner"
    require(before <= _MOST, text)
    config = _config(learner, 2 * before + _MORE)
    with TemporaryDirectory() as name:
        folder = Path(name)
        # Nothing is learned before the first update that was promised.
        if before > 1:
            early = _trainer(_config(learner, before - 1), folder / "early")
            begun = {k: t.clone() for k, t in early.learning.policy.state_dict().items()}
            early.run()
            require(
                all(
                    torch.equal(t, begun[k]) for k, t in early.learning.policy.state_dict().items()
                ),
                f"its policy changes before the {before} decisions that first_update returns",
            )

        # The whole training, and the policy that its file holds
        whole = _trainer(config, folder / "whole")
        whole.run()
        require(
            whole.learning.updates > 0, f"it learns nothing in {config.train.decisions} decisions"
        )
        saved = checkpoint.read(folder / "whole" / checkpoint.LAST)
        layout: ObservationLayout = config.perception.layout
        rows = np.random.default_rng(0).normal(0, 0.2, (64, layout.size)).astype(np.float32)
        module = policy_module(saved)
        with torch.no_grad():
            there = module(torch.from_numpy(rows))
            here = whole.learning.policy.eval()(torch.from_numpy(rows))
        require(bool(torch.equal(here, there)), "the policy of its file is another one")
        if learner.resumes_exactly:
            _resumes(config, folder)
        try:
            compare_onnx(module, config, rows)
        except MissingExtraError as error:
            raise NotChecked(str(error)) from error
        except ExportError as error:
            require(False, str(error))


def _resumes(config: TrainConfig, folder: Path) -> None:
    """Require the files of the whole training from one that is stopped after its first update."""
    from flipperctl import checkpoint

    stopped = _trainer(config, folder / "parts")
    stopped.run(stop=partial(_learnt, stopped))
    saved = checkpoint.read(folder / "parts" / checkpoint.LAST)
    resumed = _trainer(config, folder / "parts")
    resumed.restore(saved)
    resumed.run()
    for name in (checkpoint.LAST, checkpoint.BEST):
        first, other = ((folder / part / name).read_bytes() for part in ("whole", "parts"))
        require(
            first == other,
            f"{name} differs between a training and one that was stopped and resumed; tensors and "
            "counters hold all that it learns from, and training.generators its random numbers",
        )


def _learnt(trainer: Trainer) -> bool:
    return trainer.learning.updates > 0
