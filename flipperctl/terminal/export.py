"""What ``flipperctl export`` prints of a policy, a scene or an episode."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from flipperctl.api import Robot
from flipperctl.messages import unit


def print_export(target: Path, source: Path, found: dict[str, Any]) -> None:
    """Print how far the file ``target`` agrees with torch, and for which other robot it is."""
    print(
        f"{target}: {found['bytes']} bytes, from {source}\n"
        f"compared with torch on {found['observations']} observations of rollouts: "
        f"Q-values of up to {found['largest_q_value']:.2g} differ by at most "
        f"{found['largest_difference']:.2g} (allowed {found['allowed_difference']:.2g}), "
        f"the chosen action agrees on {found['action_agreement']:.2%}"
    )
    if changes := found["robot_changes"]:
        print(f"for another robot than that of the training: {_describe(changes)}")


def print_scene(found: dict[str, Any]) -> None:
    """Print which files of a scene were written, and where the robot starts in it."""
    x, y, z = found["start"]
    print(
        f"{' and '.join(found['output'])}: {found['terrain']}, seed {found['seed']}, "
        f"{found['boxes']} boxes of ground\n"
        f"the robot starts at x {x:.3f}, y {y:.3f}, z {z:.3f} m"
    )


def print_bag(found: dict[str, Any]) -> None:
    """Print which episode a bag holds, and how many messages of each topic."""
    print(
        f"{found['output']}: {found['terrain']}, seed {found['seed']}, {found['outcome']} after "
        f"{found['seconds']:.2f} s"
    )
    for topic, count in sorted(found["messages"].items()):
        print(f"  {topic}: {count}")


def print_ground(found: dict[str, Any]) -> None:
    """Print what recorded ground covers, and how to drive over it."""
    (x0, y0), (x1, y1) = found["start"], found["end"]
    without = f" ({found['clouds_without_pose']} more have no pose)"
    each = found["points_per_cloud"]
    for remark in found["remarks"]:
        print(remark)
    print(
        f"{found['output']}: {found['points']} points of {found['clouds']} clouds"
        f"{without if found['clouds_without_pose'] else ''} with {each['least']} to "
        f"{each['most']} points each, along {found['length']:.2f} m\n"
        f"drive over it with terrain=profile_file terrain.path={found['output']} "
        f"'terrain.start=[{x0},{y0}]' 'terrain.end=[{x1},{y1}]'"
    )


def _describe(changes: dict[str, dict[str, float | None]]) -> str:
    parts = []
    for name, values in changes.items():
        setting = name in Robot.model_fields
        label = f"robot.{name}" if setting else name.replace("_", " ")
        of = unit(Robot, name) if setting else "s"
        parts.append(
            f"{label} {_number(values['file'])} {of} (training {_number(values['training'])})"
        )
    return ", ".join(parts)


def _number(value: float | None) -> str:
    return "null" if value is None else f"{value:.6g}"
