"""The strongest rule and the price of each scene of the benchmark, from the rules' result files.

``flipperctl benchmark RULE…`` of the public edition writes the files;
``python -m benchmarks.prices benchmarked/*.json`` then prints the benchmark's file with new
numbers. They are set once: with another number it is another version.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

from flipperctl.api import Outcome
from flipperctl.evaluation.benchmark import (
    BenchmarkResult,
    PlayedEpisodes,
    find_benchmark,
    read_result,
)
from flipperctl.evaluation.seeds import PRICE


def main(files: list[str]) -> None:
    """Print the file of the current version with the prices that follow from the rules."""
    benchmark, rules = find_benchmark("1"), [read_result(Path(f)) for f in files]
    lines = [f"about: {benchmark.about}", "tracks:"]
    for track, content in benchmark.tracks.items():
        lines += [f"  {track}:", f"    episodes: {content.episodes}"]
        lines += [f"    flippers: {content.flippers}"] * (content.flippers != "pairs")
        lines += ["    rolls: true"] * content.rolls + ["    scenes:"]
        for name, scene in content.scenes.items():
            parts = [(rule.method, _played(rule, track, name)) for rule in rules]
            played = {rule: part for rule, part in parts if part is not None}
            # A failure costs what the roughest crossing by any rule does.
            price = round(max([PRICE, *map(_roughest, played.values())]), 3)
            costs = {rule: float(part.costs(price).mean()) for rule, part in played.items()}
            print(f"{track}: {name}: {costs}", file=sys.stderr)
            lines += [
                f"      {name}:",
                f"        words: {scene.words}",
                f"        strongest: {min(costs, key=costs.__getitem__)}",
                f"        price: {price:g}",
            ]
    print("\n".join(lines))


def _played(rule: BenchmarkResult, track: str, scene: str) -> PlayedEpisodes | None:
    here = (p.policies[0] for p in rule.scenes if (p.track, p.scene) == (track, scene))
    return next(here, None)


def _roughest(played: PlayedEpisodes) -> float:
    crossings = zip(played.outcomes, played.costs(math.inf).tolist(), strict=True)
    return max((cost for outcome, cost in crossings if outcome == Outcome.REACHED), default=0.0)


if __name__ == "__main__":
    main(sys.argv[1:])
