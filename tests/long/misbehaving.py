"""Plugins that misbehave at random, used through the command line: errors must name the plugin.

``python -m tests.long.misbehaving --count 2000 --seed 1`` prints a table of the cases and fails
unless every command ended with exit code 1 or 2 and one error that names plugin, method, file and
line.
"""

import argparse
import os
import re
import resource
import signal
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

from tests.long.forked import Command, preload, start
from tests.long.odd_plugins import BEFORE, Misbehaviour, sample_misbehaviour

LIMIT = 90.0
"""Longest time of a command [s]; worker processes import torch again, on a busy machine."""
ROOM = 6 * 2**30
"""Address space that a command may use beyond that of this process [B]."""
BRIEF = (
    *("train.decisions=60", "train.validate_every=30", "agent.batch_size=8"),
    *("train.validation_episodes=1", "train.regret_episodes=0", "agent.epsilon_decisions=1"),
    "agent.learning_starts=16",
    *("agent.epsilon_start=0", "agent.epsilon_end=0", "episode.run_out=0.2"),
)
SHORT = ("terrain=flat", *BRIEF)
DRIVEN = ("terrain=flat", "--episodes", "2")
LOOKS = ("--controller", "looking")
"""The controller beside the engine, which saves and loads the world that it looks ahead in."""

COMMANDS = {
    "terrain": {
        "inspect terrain": ["inspect", "terrain", "odd"],
        "eval": ["eval", "--controller", "level", "--episodes", "2", "terrain=odd"],
        "eval --jobs": ["eval", "--controller", "level", "--episodes=2", "--jobs=2", "terrain=odd"],
        "train": ["train", *BRIEF, "terrain=odd", "train.mode=exact"],
        "train fast": ["train", *BRIEF, "terrain=odd"],
        "inspect config": ["inspect", "config", "terrain=odd"],
    },
    "reward": {
        "inspect reward": ["inspect", "reward", "--episodes=2", "+reward@rewards.odd=odd"],
        "eval": ["eval", "--controller", "level", *DRIVEN, "+reward@rewards.odd=odd"],
        "eval --jobs": ["eval", "--controller", "level", *DRIVEN, "--jobs=2",
                        "+reward@rewards.odd=odd"],
        "train": ["train", *SHORT, "train.mode=exact", "+reward@rewards.odd=odd"],
        "train fast": ["train", *SHORT, "+reward@rewards.odd=odd"],
    },
    "network": {
        "train": ["train", *SHORT, "train.mode=exact", "network=odd"],
        "train fast": ["train", *SHORT, "network=odd"],
        "eval": ["eval", "--checkpoint", "{good}", "--episodes=2"],
        "eval --jobs": ["eval", "--checkpoint", "{good}", "--episodes=2", "--jobs=2"],
        "export onnx": ["export", "onnx", "--checkpoint", "{good}"],
    },
    "controller": {
        "eval": ["eval", "--controller", "odd", *DRIVEN],
        "eval --jobs": ["eval", "--controller", "odd", *DRIVEN, "--jobs=2"],
        "inspect reward": ["inspect", "reward", "--controller", "odd", "--episodes=1"],
    },
    "sim": {
        "eval": ["eval", "--controller", "level", *DRIVEN, "sim=odd"],
        "eval looking": ["eval", *LOOKS, *DRIVEN, "sim=odd"],
        "eval --jobs": ["eval", "--controller", "level", *DRIVEN, "--jobs=2", "sim=odd"],
        "train": ["train", *SHORT, "train.mode=exact", "sim=odd"],
        "train fast": ["train", *SHORT, "sim=odd"],
        "inspect reward": ["inspect", "reward", "--episodes=1", "terrain=flat", "sim=odd"],
        "eval engines": ["eval", "--controller", "level", *DRIVEN, "sim=planar,odd"],
        "eval --film": ["eval", "--controller", "level", "terrain=flat", "--episodes=1",
                        "--film=drive.gif", "sim=odd"],
    },
    "perception": {
        "eval": ["eval", "--controller", "level", *DRIVEN, "perception=odd"],
        "eval --jobs": ["eval", "--controller", "level", *DRIVEN, "--jobs=2", "perception=odd"],
        "train": ["train", *SHORT, "train.mode=exact", "perception=odd"],
        "train taught": ["train", *SHORT, "train.mode=exact", "perception=odd", "teacher=lookahead",
                         "teacher.privileged=true"],
        "train fast": ["train", *SHORT, "perception=odd"],
        "inspect reward": ["inspect", "reward", "--episodes=1", "terrain=flat", "perception=odd"],
        "eval engines": ["eval", "--controller", "level", *DRIVEN, "sim=planar,mujoco",
                         "perception=odd"],
    },
}  # fmt: skip
FOR_ALL = {"inspect plugins": ["inspect", "plugins", "odd"]}
SLOW = ("eval --jobs", "train fast", "export onnx")


def main() -> int:
    """Run the cases and print the table; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--slow", type=float, default=0.06, help="fraction of cases with worker processes"
    )
    parser.add_argument("--kind", default=",".join(COMMANDS), help="kinds of plugins")
    chosen = parser.parse_args()
    kinds = chosen.kind.split(",")
    preload()
    os.environ.pop("FLIPPERCTL_DEBUG", None)
    tried, reached, violations = Counter(), Counter(), Counter()
    with tempfile.TemporaryDirectory() as folder:
        good = _train_good_network(Path(folder))
        for index in range(chosen.count):
            rng = np.random.default_rng([chosen.seed, index])
            what, name, command = _case(rng, kinds, chosen.slow, good)
            work = Path(folder) / str(index)
            work.mkdir()
            file, marker = work / "odd_plugin.py", work / "marker"
            file.write_text(what.source(marker))
            done = _run([*command, "--plugins", str(file)], work)
            manner = "returns" if what.statement.startswith("return ") else "raises"
            key = (what.kind, what.spot, manner, name)
            tried[key] += 1
            reached[key] += marker.exists()
            for problem in problems(what, done, file, reached=marker.exists()):
                violations[key] += 1
                print(f"case {index}: {what}, {name}: {problem}\n  {done.text[-600:]}", flush=True)
            if index % 100 == 99:
                print(f"{index + 1} cases, {sum(violations.values())} violations", flush=True)
    for key in sorted(tried):
        print(
            *key, f"{tried[key]} cases, {reached[key]} reached, {violations[key]} wrong", sep=", "
        )
    print(f"{chosen.count} cases, {violations.total()} violations")
    return 1 if violations else 0


def problems(what: Misbehaviour, done: Command, file: Path, *, reached: bool) -> list[str]:
    """Return the faults in the exit code and the error of a command."""
    if done.code == -signal.SIGKILL:
        return ["it hangs"]
    if not reached:
        return [] if done.code == 0 else [f"exit code {done.code} though nothing misbehaved"]
    found = []
    if done.code not in (1, 2):
        found.append(f"exit code {done.code}")
    lines = done.text.partition("error: ")[2].strip().splitlines()
    if not 1 <= len(lines) <= 3 or len(done.text) > 2500:
        found.append(f"an error of {len(lines)} lines, {len(done.text)} characters")
    foreign = ("Traceback", "an error in flipperctl", "Error executing job")
    found += [f"the words {words!r}" for words in foreign if words in done.text]
    return found + unnamed(what, done.text, file)


def unnamed(what: Misbehaviour, text: str, file: Path) -> list[str]:
    """Return what the text of an error should name but does not."""
    found = []
    if not re.search(re.escape(str(file)) + r":\d+", text):
        found.append("no file and line")
    if what.spot in BEFORE:
        if what.spot != "import" and "odd" not in text.replace(str(file), ""):
            found.append("no plugin")
        return found
    if "'odd'" not in text:
        found.append("no plugin")
    methods = {"build": ("build", "forward")}.get(what.spot, (what.spot,))
    if not any(method in text for method in methods):
        found.append("no method")
    return found


def _case(
    rng: np.random.Generator, kinds: list[str], slow: float, good: Path
) -> tuple[Misbehaviour, str, list[str]]:
    kind = str(rng.choice(kinds))
    what = sample_misbehaviour(rng, kind)
    known = COMMANDS[kind] | (FOR_ALL if what.spot in BEFORE else {})
    is_slow = rng.random() < slow
    names = [name for name in known if (name in SLOW) == is_slow] or list(known)
    name = str(rng.choice(names))
    return what, name, [part.format(good=good) for part in known[name]]


def _train_good_network(folder: Path) -> Path:
    """Train a network ``odd`` that does not misbehave; return its run directory."""
    file = folder / "odd_plugin.py"
    file.write_text(Misbehaviour("network", "forward", "pass", 10**9).source(folder / "marker"))
    run = folder / "good"
    arguments = [*COMMANDS["network"]["train"], f"hydra.run.dir={run}", "--plugins", str(file)]
    done = _run(arguments, folder)
    if done.code != 0:
        raise RuntimeError(done.text)
    return run


def _run(arguments: list[str], folder: Path) -> Command:
    """Run a command in a child of this process, with limits on its time and memory."""
    command = start(arguments, folder, folder / "err", folder / "out", _limit_memory)
    command.wait(LIMIT)
    return command


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + ROOM
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


if __name__ == "__main__":
    sys.exit(main())
