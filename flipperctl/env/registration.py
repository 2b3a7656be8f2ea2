"""Called through Gymnasium's entry-point group; imports nothing heavy."""

import gymnasium


def register() -> None:
    """Makes ``flipperctl/Flipper-v0`` known; the group's entry name is the namespace."""
    gymnasium.register("Flipper-v0", entry_point="flipperctl.env.flipper_env:FlipperEnv")
