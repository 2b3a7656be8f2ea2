"""The task as a Gymnasium environment: observation, action, reward and termination.

Importing this package registers ``flipperctl/Flipper-v0``. Gymnasium reads no entry points since
1.0, so either import this package, or let Gymnasium import it:
``gymnasium.make("flipperctl.env:flipperctl/Flipper-v0")``.
"""

import gymnasium

gymnasium.register("flipperctl/Flipper-v0", entry_point="flipperctl.env.flipper_env:FlipperEnv")
