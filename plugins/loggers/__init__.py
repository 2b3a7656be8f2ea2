"""Built-in loggers; a tracker's library is imported only when its logger is opened."""

from . import tensorboard, wandb

__all__ = ["tensorboard", "wandb"]
