"""The Python interface, whose names are imported from ``flipperctl``."""

from flipperctl.scripting.interface import Evaluation, LoadedPolicy, Run, evaluate, load, train

__all__ = ["Evaluation", "LoadedPolicy", "Run", "evaluate", "load", "train"]
