"""Messages of a builder who makes each motion of the self-test, in place of a robot's driver.

    python examples/messages/self_test.py > messages.jsonl
    python -m flipperctl.runtime --self-test messages.jsonl --signs rep103

A driver of your own prints such a line for each step: what its devices measured since the last one.
"""

import json
import math
from collections.abc import Iterator

PERIOD = 0.05
"""Time between two lines [s]."""


def share(time: float, begin: float) -> float:
    """Return how much of a motion is done that begins at a time and takes 2 s, 0 to 1."""
    return min(1.0, max(0.0, (time - begin) / 2))


def points(board: bool) -> list[tuple[float, float, float]]:
    """Return a board 0.5 m ahead of a LiDAR that looks down by 45°, and ground, in its frame."""
    found = [(0.1 * i, 0.1 * j, -0.5) for i in range(-5, 15) for j in (-2, 0, 2)]
    if board:
        found += [(0.5, 0.1 * j, 0.1 * k - 0.2) for j in range(-2, 3) for k in range(5)]
    half = math.sqrt(0.5)
    return [(half * (-x - z), y, half * (x - z)) for x, y, z in found]


def lines() -> Iterator[dict[str, object]]:
    """Yield the messages of 26 s, in the signs of REP 103: front flippers and nose down positive.

    A motion begins every 4 s: front flippers up, rear flippers up, nose up, turn to the left while
    it is lowered, drive ahead, hold a board.
    """
    for step in range(round(26 / PERIOD)):
        time = step * PERIOD
        front, rear, nose, turn, drive, board = (share(time, 4 * i + 1) for i in range(6))
        yield {
            "time": time,
            "joints": {"front": -0.5 * front, "rear": 0.5 * rear},
            "attitude": {
                "frame": "base_link",
                "roll": 0.0,
                "pitch": -0.2 * nose * (1 - turn),
                "yaw_rate": 0.4 if 0 < turn < 1 else 0.0,
            },
            "odometry": {"speed": 0.2 if 0 < drive < 1 else 0.0},
            "cloud": {"frame": "lidar", "points": points(board == 1)},
        }


if __name__ == "__main__":
    for line in lines():
        print(json.dumps(line))
