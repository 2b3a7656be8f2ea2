"""Connect to the cluster of Hydra's Ray launcher, which cannot join a running one by itself.

The launcher requests an object store of its own size, which Ray refuses when it joins a cluster
(hydra-ray-launcher 1.2). It uses an existing connection.
"""

from __future__ import annotations

import sys
from typing import Any

from hydra.plugins.launcher import Launcher
from omegaconf import OmegaConf

from flipperctl.rollout.ray_cluster import is_connected, join

_OBJECT_STORE = 75 * 2**20
"""Memory for objects of a cluster of the launcher's own, which is its default [B]."""
_MODULE = "hydra_plugins.hydra_ray_launcher.ray_launcher"


def connect(launcher: Launcher) -> None:
    """Connect to the cluster of a Ray launcher; do nothing for other launchers.

    Without an address, Ray joins the cluster that ``ray start`` has started on this machine, or
    starts one; at the address ``local``, it always starts one.

    Raises:
        ConfigError: no cluster answers, it asks for a token, or it refuses a setting.
    """
    module = sys.modules.get(_MODULE)
    if module is None or not isinstance(launcher, module.RayLauncher):
        return
    if is_connected():
        return
    found: Any = launcher
    settings: Any = OmegaConf.to_container(found.ray_cfg.init, resolve=True)
    address = settings.pop("address", None)
    if address == "local":
        settings.setdefault("object_store_memory", _OBJECT_STORE)
    join(address, "hydra.launcher.ray.init.address", **settings)
