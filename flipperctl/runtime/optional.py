"""Entries of an exported policy's metadata that not every file has, each read strictly.

In: the metadata. Out: what an entry states, and what a file without it means.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from flipperctl.core.escape import EscapeRule
from flipperctl.core.lidar.map_quality import MapQuality
from flipperctl.core.risk import LAGS, SCALE, RiskSign
from flipperctl.core.targets import TargetRule
from flipperctl.runtime.checksum import PREFIX
from flipperctl.runtime.entries import is_count, is_positive, read_entry

TARGETS = f"{PREFIX}targets"
"""Metadata entry of the rule for the flippers' targets."""
RISK = f"{PREFIX}risk"
"""Metadata entry of the risk, in files whose policy tells one."""
ESCAPE = f"{PREFIX}escape"
"""Metadata entry of how actions are drawn on a warning, in files whose policy does so."""
MAP = f"{PREFIX}map"
"""Metadata entry of the map's settings, in files whose policy was trained with a LiDAR."""


def targets(metadata: Mapping[str, str], where: str, robot: Mapping[str, float]) -> TargetRule:
    """Return the rule for the targets; without its entry, the rule of earlier versions."""
    if TARGETS not in metadata:
        return TargetRule(window=math.inf, limit=robot.get("angle_limit", math.inf))
    rule = read_entry(
        metadata,
        where,
        TARGETS.removeprefix(PREFIX),
        "a mapping with the angles window and limit, each above 0",
        lambda v: (
            isinstance(v, dict) and all(is_positive(v.get(key)) for key in ("window", "limit"))
        ),
    )
    return TargetRule(window=rule["window"], limit=rule["limit"])


def risk(metadata: Mapping[str, str], where: str) -> RiskSign | None:
    """Return when the risk is a warning; None if the file has no risk."""
    if RISK not in metadata:
        return None
    sign = read_entry(
        metadata,
        where,
        RISK.removeprefix(PREFIX),
        "a mapping with the whole number horizon, the threshold, above 0 and at most 1, the lags "
        f"{list(LAGS)} and the scale {SCALE}",
        lambda v: (
            isinstance(v, dict)
            and is_count(v.get("horizon"))
            and is_positive(v.get("threshold"))
            and v["threshold"] <= 1
            and (v.get("lags"), v.get("scale")) == (list(LAGS), SCALE)
        ),
    )
    return RiskSign(sign["horizon"], float(sign["threshold"]))


def escape(metadata: Mapping[str, str], where: str) -> EscapeRule | None:
    """Return how actions are drawn on a warning; None if they never are."""
    if ESCAPE not in metadata:
        return None
    rule = read_entry(
        metadata,
        where,
        ESCAPE.removeprefix(PREFIX),
        f"a mapping with the temperature, above 0, and the whole number decisions, beside {RISK},",
        lambda v: (
            isinstance(v, dict)
            and is_positive(v.get("temperature"))
            and is_count(v.get("decisions"))
            and RISK in metadata
        ),
    )
    return EscapeRule(float(rule["temperature"]), rule["decisions"])


def map_quality(metadata: Mapping[str, str], where: str) -> MapQuality | None:
    """Return the settings of the training's map; None if the file does not state them."""
    if MAP not in metadata:
        return None
    lengths, counts = ("cell", "lane", "half_width", "noise"), ("keep", "fewest")
    quality = read_entry(
        metadata,
        where,
        MAP.removeprefix(PREFIX),
        f"a mapping with the lengths {', '.join(lengths)}, each above 0, the whole numbers "
        f"{' and '.join(counts)}, each above 0, and deskew, true or false,",
        lambda v: (
            isinstance(v, dict)
            and all(is_positive(v.get(key)) for key in lengths)
            and all(is_count(v.get(key)) for key in counts)
            and isinstance(v.get("deskew"), bool)
        ),
    )
    return MapQuality(
        cell=float(quality["cell"]),
        lane=float(quality["lane"]),
        keep=quality["keep"],
        half_width=float(quality["half_width"]),
        fewest=quality["fewest"],
        noise=float(quality["noise"]),
        deskew=quality["deskew"],
    )
