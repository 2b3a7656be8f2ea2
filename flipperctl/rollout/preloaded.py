"""What the fork server imports once for all its workers: actors, compiled loops, plugins."""

import flipperctl.rollout.collect
import flipperctl.sim.planar.compiled  # noqa: F401
from flipperctl.plugging import plugins

plugins.load_installed()
