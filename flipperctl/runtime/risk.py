"""The risk that an exported policy tells beside its Q-values.

In: the outputs of its session, and the observations of the episode. Out: a probability.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.core.risk import LAGS, Recurrence, with_recurrence
from flipperctl.errors import NonFiniteError
from flipperctl.runtime.session import RECURRENCE, RISK


class BoundRisk:
    """The risk of a session with bound outputs, which overwrites them at each decision."""

    def __init__(self, bound: Any, size: int) -> None:
        """``bound``: the session's binding of inputs and outputs; ``size``: N + 3."""
        self._alone = np.zeros((1, 1), np.float32)
        self._coefficients = np.zeros((1, len(LAGS)), np.float32)
        for name, array in ((RISK, self._alone), (RECURRENCE, self._coefficients)):
            bound.bind_output(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)
        self._recurrence = Recurrence(size)
        self.value: float | None = None
        """Risk at the last decision, 0 to 1; None before one."""

    def reset(self) -> None:
        """Begin an episode."""
        self._recurrence.reset()
        self.value = None

    def update(self, observation: NDArray[np.float32], path: Path) -> None:
        """Compute the risk after a run of the session on ``observation``, (N + 3,).

        Raises:
            NonFiniteError: the risk is NaN or infinite; the text names ``path``.
        """
        resembles = self._recurrence.add(observation)
        self.value = with_recurrence(self._alone.item(), self._coefficients[0], resembles)
        if math.isnan(self.value):
            raise NonFiniteError(
                f"{path}: the risk is not a finite number; the file is damaged, or the observation "
                "is far from those of the training"
            )
