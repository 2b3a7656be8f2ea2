"""Built-in loggers; a tracker's library is imported only when its logger is opened."""

from . import tensorboard, trackio, wandb

__all__ = ["tensorboard", "trackio", "wandb"]
