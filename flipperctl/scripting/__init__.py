"""The Python interface, whose names are imported from ``flipperctl``."""

from flipperctl.scripting.interface import Evaluation, Run, evaluate, train
from flipperctl.scripting.policy import LoadedPolicy, load

__all__ = ["Evaluation", "LoadedPolicy", "Run", "evaluate", "load", "train"]
