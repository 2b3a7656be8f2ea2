"""The learners of the package, which the trainer knows by ``flipperctl.api.Learner`` alone.

Each is a file of settings, which imports no torch, and one of what learns in a run. The library
that they share with learners of others is ``flipperctl.agent``: networks, replay, losses, risk.
"""

from flipperctl.learners.d3qn import D3qn
from flipperctl.learners.policy_gradient import PolicyGradient
from flipperctl.learners.sb3 import Sb3

__all__ = ["D3qn", "PolicyGradient", "Sb3"]
