"""Pictures of an episode for ``render_mode="rgb_array"``.

In: a world and a scene. Out: an (HEIGHT, WIDTH, 3) picture. It is drawn by the engine, if the
engine draws pictures, else by a renderer of scenes. The default renderer is the entry point
``side`` of the group ``flipperctl.renderers``, so that the environment imports no plotting code.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import distributions

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import DrawingWorld, World
from flipperctl.env.scene import HEIGHT, WIDTH, Scene
from flipperctl.errors import ConfigError
from flipperctl.messages import close_match

MODES = ("rgb_array",)
"""Values of ``render_mode`` besides None."""
GROUP = "flipperctl.renderers"
"""Group of entry points of renderers; each is a class that is made without arguments."""

Picture = NDArray[np.uint8]
Renderer = Callable[[Scene], Picture]
"""Returns a picture of a scene, (HEIGHT, WIDTH, 3)."""


def check_mode(mode: str | None) -> None:
    """Check that a render mode exists.

    Raises:
        ConfigError: it does not.
    """
    if mode is not None and mode not in MODES:
        raise ConfigError(
            f"render_mode: there is no mode {mode!r}{close_match(str(mode), MODES)}; "
            f"None or {', '.join(map(repr, MODES))} is allowed"
        )


class Pictures:
    """Draws the pictures of one environment."""

    def __init__(self, renderer: Renderer | None) -> None:
        """Draw scenes with ``renderer``; None: the installed one, loaded at the first picture."""
        self._renderer = renderer

    def draw(self, world: World, scene: Callable[[], Scene]) -> Picture:
        """Return the world's own picture, if it draws one, else that of the current ``scene``.

        Raises:
            RequestError: the machine lacks a library that the engine needs for drawing.
            PluginFailedError: the code of the engine failed.
            ConfigError: no renderer is installed.
        """
        if isinstance(world, DrawingWorld):
            return world.draw(WIDTH, HEIGHT)
        if self._renderer is None:
            self._renderer = installed()
        return self._renderer(scene())


def installed() -> Renderer:
    """Return a new renderer of scenes from the side.

    Raises:
        ConfigError: none is installed.
    """
    # In all copies of the metadata: a stale one in the working directory would hide the other.
    copies = [points for d in distributions(name="flipperctl") for points in d.entry_points]
    found = [point for point in copies if point.group == GROUP]
    if not found:
        raise ConfigError(
            f"render_mode: no entry point 'side' in the group {GROUP!r}; "
            "reinstall flipperctl (pip install -e .)"
        )
    renderer: Renderer = found[0].load()()
    return renderer
