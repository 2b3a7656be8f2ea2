"""The Python interface: train, evaluate and load policies, in scripts and notebooks.

It composes, locks, writes and refuses as the commands do, since it calls the same code. Import its
names from ``flipperctl``.
"""

from flipperctl.library.evaluating import evaluate
from flipperctl.library.evaluation import Evaluation
from flipperctl.library.policy import LoadedPolicy, load
from flipperctl.library.run import Run
from flipperctl.library.training import train

__all__ = ["Evaluation", "LoadedPolicy", "Run", "evaluate", "load", "train"]
