"""What a robot computes, in numpy alone: observations, actions, targets, and a map of the ground.

The environment and ``flipperctl.runtime`` both import it, so that the simulator and a robot cannot
differ. It imports nothing else of flipperctl.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
"""An array of floats of any shape."""
