"""Writes the instants of ``flipperctl export vectors`` as plain numbers, for ``check.cpp``.

c++ -std=c++17 check.cpp -o check && python check.py vectors.json | ./check
"""

import json
import sys
from pathlib import Path


def lines(document):
    """Yield lines of numbers: the layout, then each instant."""
    instants, actions = document["instants"], document["actions"]
    layout = [document["bins"], document["bin_width"], int(document["highest"])]
    rule = [document["frames"], document["window"], document["limit"]]
    output = "q_values" if document["kind"] == "turns" else "rates"
    sides = document.get("sides", False)
    sizes = len(actions), len(instants[0][output]), len(actions[0]), int(sides)
    yield [len(instants), *layout, *rule, *sizes]
    yield from actions
    before = None
    for instant in instants:
        episode = instant["episode"]
        yield [int(episode != before)]
        for ground in ("points", "left", "right"):
            points = instant.get(ground, [])
            yield [len(points), *(c for point in points for c in point)]
        angles = instant.get("flippers", [instant["front"], instant["rear"]])
        yield [*angles, instant["pitch"], instant.get("roll", 0.0), *instant["input"]]
        yield [*instant[output], *instant["targets_before"], *instant["targets"]]
        before = episode


if __name__ == "__main__":
    for line in lines(json.loads(Path(sys.argv[1]).read_text())):
        print(*(repr(number) for number in line))
