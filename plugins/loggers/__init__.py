"""Built-in loggers; importing them imports no tracker, opening one does."""

from . import tensorboard, trackio, wandb

__all__ = ["tensorboard", "trackio", "wandb"]
