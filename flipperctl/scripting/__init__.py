"""The Python interface: train, evaluate and load policies, in scripts and notebooks.

It composes, locks, writes and refuses as the commands do, since it calls the same code. Import its
names from ``flipperctl``.
"""

from flipperctl.scripting.evaluating import Evaluation, evaluate
from flipperctl.scripting.policy import LoadedPolicy, load
from flipperctl.scripting.training import Run, train

__all__ = ["Evaluation", "LoadedPolicy", "Run", "evaluate", "load", "train"]
