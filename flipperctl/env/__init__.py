"""Observation, action, reward sum and ends: the task as a Gymnasium environment.

Importing this package registers ``flipperctl/Flipper-v0``. Gymnasium reads no entry points since
1.0, so either import it, or let Gymnasium do so:
``gymnasium.make("flipperctl.env:flipperctl/Flipper-v0")``.
"""

import gymnasium

gymnasium.register("flipperctl/Flipper-v0", entry_point="flipperctl.env.flipper_env:FlipperEnv")
