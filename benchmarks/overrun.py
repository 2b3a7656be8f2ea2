"""How far past the finish episodes end: a robot that stays nose up reaches it late, or never.

    python -m benchmarks.overrun [--policy NAME] [--terrain K,…] [--episodes N] …

A robot has arrived once both its ends are close to the ground. The command prints the share of
episodes that drove more than ``--more`` [m] past the finish, the farthest, and each of them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import flipperctl
from flipperctl.process import entry

_TEN = "step,stair,building_stair,ramp,uplift,gap,wave,rubble,pallet,plum"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the counts."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.overrun")
    parser.add_argument("--policy", default="generalist")
    parser.add_argument("--terrain", default=_TEN)
    parser.add_argument("--conditions", default="nominal")
    parser.add_argument("--episodes", type=int, default=100, help="of each terrain")
    parser.add_argument("--seed", type=int, default=730_000, help="of the first episode")
    parser.add_argument("--more", type=float, default=1.0, help="[m]")
    options = parser.parse_args(arguments)
    policy, past = flipperctl.load(options.policy), list[float]()
    perception = None if policy.layout is None else policy.layout.model_dump()
    for kind in options.terrain.split(","):
        made = flipperctl.environment(
            terrain=kind, conditions=options.conditions, perception=perception
        )
        env: Any = made.unwrapped
        for seed in range(options.seed, options.seed + options.episodes):
            made.reset(seed=seed)
            policy.reset(made)
            over = False
            while not over:
                _, _, terminated, truncated, info = made.step(policy.act(env.perception))
                over = terminated or truncated
            past.append(float(env.drive.state.position[0]) - env.drive.termination.finish)
            if past[-1] > options.more:
                print(f"{kind}, seed {seed}: {past[-1]:.2f} m past the finish, {info['outcome']}")
    count = sum(value > options.more for value in past)
    print(
        f"{count} of {len(past)} more than {options.more:g} m past the finish; "
        f"farthest {max(past):.2f} m"
    )
    return 0


if __name__ == "__main__":
    entry.run(main)
