"""What ``flipperctl inspect perception`` and ``flipperctl shadow`` print."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flipperctl.show import NONE, Column, Table, print_table
from flipperctl.terminal.console import console

_COLUMNS = (Column("what", "what", named=True), Column("found", "found", wrapped=True))


def print_perception(found: dict[str, Any], output: Path | None) -> None:
    """Print how a robot's sensing fared on its recording; ``output`` was written."""
    topics = ", ".join(f"{device} {topic}" for device, topic in found["topics"].items())
    print(f"{found['source']}: {found['seconds']:.1f} s; {topics}")
    rows: dict[str, str] = {}
    refused = sum(one["count"] for one in found["refused"].values())
    rows["scans used"] = str(found["scans"])
    rows["scans refused"] = str(refused)
    for name, one in found["refused"].items():
        rows[f"  {name}"] = f"{one['count']}: {one['reason']}"
    rows["estimates"] = str(found["decisions"])
    for name, count in found["held"].items():
        rows[f"  would hold: {name}"] = str(count)
    coverage, deviation = found["coverage"], found["deviation"]
    rows["bins seen"] = f"{coverage['mean']:.0%}, at least {coverage['least']:.0%}"
    rows["ground filled"] = f"{found['filled']:.0%}"
    rows["σ of a height"] = NONE if deviation is None else f"{1000 * deviation:.0f} mm (median)"
    for name, key in (("an estimate", "estimate_ms"), ("a scan", "scan_ms")):
        times = found[key]
        rows[f"{name} takes"] = f"{times['p50']:.1f} ms, p99 {times['p99']:.1f} ms"
    rows["scans enter at"] = _pose(found)
    if found["drift"] is not None:
        rows["drift"] = _drift(found["drift"])
    _print("perception", rows)
    for remark in found["remarks"]:
        print(remark)
    if output is not None:
        print(f"written: {output}")


def _print(title: str, rows: Mapping[str, str]) -> None:
    table = Table(_COLUMNS, [{"what": what, "found": text} for what, text in rows.items()], title)
    print_table(table, console())


def _pose(found: dict[str, Any]) -> str:
    return {
        "true": "the poses of the recording",
        "belts": "odometry by belts and inertial unit",
        "matched": "odometry, corrected by matching",
    }[found["pose"]]


def _drift(drift: dict[str, float | None]) -> str:
    share = "" if drift["share"] is None else f" ({drift['share']:.1%} of {drift['way']:.2f} m)"
    heading = math.degrees(drift["heading"] or 0.0)
    return (
        f"{1000 * (drift['horizontal'] or 0.0):.0f} mm{share}, height "
        f"{1000 * (drift['height'] or 0.0):+.0f} mm, heading {heading:+.1f}° against the recording"
    )


def print_shadow(found: dict[str, Any]) -> None:
    """Print how a policy fared on a recording in shadow mode, and where its log is."""
    topics = ", ".join(f"{device} {topic}" for device, topic in found["topics"].items())
    print(f"{found['policy']} on {found['source']}: {found['seconds']:.1f} s; {topics}")
    rows = {"decisions": str(found["decisions"])}
    for state, seconds in found["states"].items():
        rows[state] = f"{seconds:.1f} s"
    for name, fault in found["faults"].items():
        rows[f"  {name}"] = f"{fault['count']} ×, {fault['seconds']:.1f} s: {fault['reason']}"
    _print("shadow mode", rows)
    for remark in found["remarks"]:
        print(remark)
    print(f"log: {found['output']}")
