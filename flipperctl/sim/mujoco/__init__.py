"""The 3-D engine; importing this package registers it as ``mujoco``.

Placing a robot imports the library MuJoCo, which the extra
``flipperctl[mujoco]`` installs.
"""

from flipperctl.sim.mujoco.engine import Mujoco

__all__ = ["Mujoco"]
