"""The Python interface, whose names are imported from ``flipperctl``."""

from flipperctl.scripting.interface import Evaluation, Run, environment, evaluate, plot, train
from flipperctl.scripting.policy import LoadedPolicy, load, save

__all__ = [
    "Evaluation",
    "LoadedPolicy",
    "Run",
    "environment",
    "evaluate",
    "load",
    "plot",
    "save",
    "train",
]
