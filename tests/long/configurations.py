"""Random configurations over every section: each trains 60 decisions or is refused by name.

``python -m tests.long.configurations --count 1000 --seed 1`` prints how many trained, how many each
section refused and, for each fault, the command that shows it; it fails if there is a fault.
"""

import argparse
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings

from flipperctl import plugins
from flipperctl.lookahead.model import compile_now
from tests.configurations import Attempt, Overrides, attempt, command, overrides
from tests.machine_code import compile_environment


def main() -> int:
    """Train the drawn configurations and print the table; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, help="draw no more after this time")
    chosen = parser.parse_args()
    plugins.load()
    compile_environment()  # outside of any training's time
    compile_now()
    found: dict[str, Attempt] = {}
    end = time.monotonic() + (chosen.seconds or float("inf"))

    @seed(chosen.seed)
    @settings(
        max_examples=2 * chosen.count,
        phases=[Phase.generate],
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(drawn=overrides())
    def draw(drawn: Overrides) -> None:
        if time.monotonic() > end or len(found) >= chosen.count or command(drawn) in found:
            return
        with tempfile.TemporaryDirectory() as folder:
            result = attempt(drawn, Path(folder) / "run")
        found[command(drawn)] = result
        if result.kind in ("fault", "unnamed", "too long"):
            print(f"{result.kind}: {result.text}\n  {command(drawn)}", flush=True)
        if len(found) % 100 == 0:
            print(f"{len(found)} configurations", flush=True)

    draw()
    return report(list(found.values()))


def report(results: list[Attempt]) -> int:
    """Print the numbers; return 1 if there was a fault."""
    kinds = Counter(result.kind for result in results)
    sections = Counter(result.section for result in results if result.kind == "refused")
    print(f"{len(results)} configurations: {dict(kinds)}; refused: {dict(sections)}")
    return 1 if kinds.keys() - {"trained", "refused"} else 0


if __name__ == "__main__":
    sys.exit(main())
