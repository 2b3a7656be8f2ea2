"""What a change of structure must keep: written before the change, compared after it.

    python -m tests.long.golden --write golden.json
    python -m tests.long.golden --compare golden.json --only episodes,refusals

``episodes``: each column of some 200 episodes, and digests of what ``gymnasium.make`` returns.
``trainings``: each tensor and row of metrics of short trainings, one of them stopped and resumed.
``evaluations``: each entry of the documents of commands with ``--json``, and of their tables.
``refusals``: exit codes and texts of wrong requests. ``export``: metadata and outputs of ONNX.

It knows only the command line, the names of ``flipperctl``, Gymnasium and formats of files. Numbers
are compared bit for bit. They depend on the kind of CPU and on the versions of numpy and torch, so
the file is not committed: write it on the same machine, from the commit before the change. The exit
code is 1 if an entry has changed or is missing; new entries are only listed. An intended
difference is named in the message of the commit that makes it.
"""

import argparse
import csv
import hashlib
import json
import os
import platform
import re
import shlex
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

os.environ["OMP_NUM_THREADS"] = "1"  # read once, by numpy and torch

from tests.long import golden_cases as cases

ROOT = Path(__file__).parents[2]
AT_ONCE = 2
"""Commands that run at the same time."""
SHOWN = 20
"""Differences of each kind that are printed."""
_MASKED = re.compile(r"(^|/)(seconds|versions|flipperctl\.package_version)(/|$)")
"""Entries that differ between equal runs, or between versions."""

Entries = dict[str, Any]
Job = str | Callable[[], object]


class Done(NamedTuple):
    """What a job left: its exit code and its output, without paths of this machine."""

    code: int
    out: str
    err: str


def run(jobs: Mapping[str, Job], folder: Path) -> dict[str, Done]:
    """Run jobs in forked processes, whose working directory is ``folder``."""
    done: dict[str, Done] = {}
    running: dict[int, tuple[str, Path]] = {}
    waiting = list(jobs)
    with TemporaryDirectory(prefix="golden-logs-") as logs:
        while waiting or running:
            while waiting and len(running) < AT_ONCE:
                name = waiting.pop(0)
                log = Path(logs, str(len(done) + len(running)))
                running[start(jobs[name], folder, log)] = name, log
            pid, status = os.wait()
            if pid not in running:  # a child of who imports this module
                continue
            name, log = running.pop(pid)
            done[name] = _done(log, os.waitstatus_to_exitcode(status), folder)
    return {name: done[name] for name in jobs}


def start(job: Job, folder: Path, log: Path) -> int:
    """Fork a process that runs a command line, an expression or a function; return its id."""
    sys.stdout.flush()
    sys.stderr.flush()
    if pid := os.fork():
        return pid
    code = 70
    try:
        for number, suffix in ((1, ".out"), (2, ".err")):
            os.dup2(os.open(log.with_suffix(suffix), os.O_WRONLY | os.O_CREAT, 0o644), number)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")  # pytest has others
        signal.signal(signal.SIGINT, signal.default_int_handler)  # background shells ignore it
        os.chdir(folder)
        code = _run(job, folder)
    except SystemExit as left:
        code = left.code if isinstance(left.code, int) else 70
    except BaseException:  # noqa: BLE001 (the child must never return into the parent's code)
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _run(job: Job, folder: Path) -> int:
    if isinstance(job, str) and not job.startswith("flipperctl."):
        from flipperctl.__main__ import main

        sys.argv = ["flipperctl", *(_first(word, folder) for word in shlex.split(job))]
        main()
        return 70  # main leaves by SystemExit
    import flipperctl
    from flipperctl.errors import FlipperctlError

    try:
        found = eval(job, {"flipperctl": flipperctl}) if isinstance(job, str) else job()
    except FlipperctlError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    print(json.dumps(found))
    return 0


def _first(word: str, folder: Path) -> str:
    found = sorted(folder.glob(word)) if "*" in word else []
    return str(found[0].relative_to(folder)) if found else word


def _done(log: Path, code: int, folder: Path) -> Done:
    texts = (log.with_suffix(suffix).read_text(errors="replace") for suffix in (".out", ".err"))
    texts = (text.replace(str(folder), "FOLDER").replace(str(ROOT), "ROOT") for text in texts)
    texts = (re.sub(r"(ROOT/\S+\.py):\d+", r"\1", text) for text in texts)
    return Done(code, *(re.sub(r"(?m)^.* episodes, .* s left.*\n", "", text) for text in texts))


def flat(value: object, path: str) -> Iterator[tuple[str, object]]:
    """Return the numbers and texts of nested dicts and lists, each with its path."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        if not value:
            yield path, value
        for key, inner in items:
            yield from flat(inner, f"{path}/{key}")
    elif not _MASKED.search(path):
        yield path, value


def document(name: str, done: Done) -> Entries:
    """Return the entries of a JSON document on standard output, or the error instead."""
    if done.code:
        return {f"{name}/exit code": done.code, f"{name}/error": done.err}
    return dict(flat(json.loads(done.out), name))


def table(file: Path, name: str, key: Callable[[int, dict[str, str]], str]) -> Entries:
    """Return the columns of a CSV file that are not empty, each row by its key."""
    with file.open(newline="") as text:
        rows = [(key(index, row), row) for index, row in enumerate(csv.DictReader(text))]
    found = {f"{row_key}/{k}": v for row_key, row in rows for k, v in row.items() if v}
    return dict(flat(found, name))


def digest(*parts: bytes) -> str:
    """Return the beginning of a SHA-256."""
    return hashlib.sha256(b"".join(parts)).hexdigest()[:24]


def episodes(folder: Path) -> Entries:
    """Return the columns of episodes and, where the store has it, the digest of their poses."""
    jobs: dict[str, Job] = {
        name: f"eval {words} --seed 5 --baseline none --output 'episodes/{name}' --json"
        for name, words in cases.EPISODES.items()
    }
    jobs |= {name: partial(walk, *given) for name, given in cases.WALKS.items()}
    found: Entries = {}
    for name, done in run(jobs, folder).items():
        if name not in cases.EPISODES:
            found |= document(name, done)
            continue
        found[f"{name}/exit code"] = done.code
        output = folder / "episodes" / name
        for file in output.glob("episodes.csv"):
            found |= table(file, name, lambda _, row: f"{row['terrain']}/{row['seed']}")
        for file in output.rglob("*.jsonl"):
            for row in map(json.loads, file.read_text().splitlines()):
                if "digest" in row:
                    found[f"{name}/{row['terrain']}/{row['seed']}/digest"] = row["digest"]
    return found


def walk(policy: str, settings: dict[str, str]) -> Entries:
    """Return what the environment returns to a loaded policy, or else to random actions."""
    import gymnasium
    import numpy as np

    import flipperctl

    found: Entries = {}
    for ground in cases.GROUNDS.split(","):
        env = gymnasium.make("flipperctl.env:flipperctl/Flipper-v0", terrain=ground, **settings)
        observations, rewards, over = [env.reset(seed=7)[0]], [], False
        rng = np.random.default_rng(3)
        driver = flipperctl.load(policy) if policy else None
        if driver:
            driver.reset(env)
        while not over and (driver or len(rewards) < 30):
            action = driver.act(env.unwrapped.perception) if driver else int(rng.integers(9))
            observation, reward, terminated, truncated, info = env.step(action)
            over = terminated or truncated
            observations.append(observation)
            rewards.append(float(reward))
        digests = (digest(np.array(values).tobytes()) for values in (observations, rewards))
        found[ground] = [len(rewards), *digests, info.get("metrics")]
    return found


def train(names: Iterable[str], folder: Path) -> None:
    """Train what is not there yet."""
    jobs: dict[str, Job] = {
        name: cases.training(name) for name in names if not (folder / name).exists()
    }
    for name, done in run(jobs, folder).items():
        if done.code:
            raise SystemExit(f"the training {name} failed: {done.err}")


def stop(name: str, folder: Path) -> int:
    """Begin a training and interrupt it after its first checkpoint; return the exit code."""
    pid = start(cases.training(name), folder, folder / "stopped")
    while not (status := os.waitpid(pid, os.WNOHANG))[0]:
        if list((folder / name).rglob("last.safetensors")):
            os.kill(pid, signal.SIGINT)
            status = os.waitpid(pid, 0)
            break
        time.sleep(0.002)
    return os.waitstatus_to_exitcode(status[1])


def trainings(folder: Path) -> Entries:
    """Return digests of tensors, metadata, metrics and summaries of runs."""
    found: Entries = {"resumed/exit code when stopped": stop("resumed", folder)}
    train((name for name in cases.TRAININGS if name != "resumed"), folder)
    done = run({"resumed": "train --resume resumed"}, folder)["resumed"]
    found["resumed/exit code"] = done.code
    for file in sorted(file for name in cases.TRAININGS for file in (folder / name).rglob("*")):
        path = str(file.relative_to(folder))
        if file.suffix == ".safetensors":
            found |= weights(file, path)
        elif file.name == "metrics.csv":
            found |= table(file, path, lambda index, row: f"{row['kind']} {index}")
        elif file.name == "summary.json":
            found |= dict(flat(json.loads(file.read_text()), path))
    whole = {key: value for key, value in found.items() if key.startswith("whole/")}
    pairs = ((key.replace("whole/", "resumed/", 1), value) for key, value in whole.items())
    found["resumed/not as whole"] = [key for key, value in pairs if found.get(key) != value]
    return found


def weights(file: Path, name: str) -> Entries:
    """Return the digest of each tensor, of all of them without names, and the metadata."""
    from safetensors import safe_open

    found: Entries = {}
    with safe_open(file, "np") as opened:
        for key in opened.keys():  # noqa: SIM118 (it is no dict)
            tensor = opened.get_tensor(key)
            kind = f"{tensor.dtype} {'×'.join(map(str, tensor.shape))}"
            found[f"{name}/tensor {key}"] = f"{kind} {digest(tensor.tobytes())}"
        metadata = opened.metadata() or {}
    found[f"{name}/any names"] = digest(*(text.encode() for text in sorted(found.values())))
    return found | dict(flat({key: _parsed(text) for key, text in metadata.items()}, name))


def _parsed(text: str) -> object:
    return json.loads(text) if text[:1] in ("{", "[") else text


def evaluations(folder: Path) -> Entries:
    """Return the documents of commands, and the tables that they wrote."""
    train(cases.NEEDED, folder)
    found: Entries = {}
    for batch in cases.EVALUATIONS:
        for name, done in run(batch, folder).items():
            found |= document(name, done)
    for file in sorted(folder.glob("*/table.csv")):
        found |= table(file, str(file.relative_to(folder)), lambda index, _: str(index))
    return found


def refusals(folder: Path) -> Entries:
    """Return exit codes and texts of wrong requests, and which files they left behind."""
    train(("paper", "sweep"), folder)
    good = next((folder / "paper").rglob("best.safetensors")).read_bytes()
    middle = len(good) // 2
    (folder / "cut.safetensors").write_bytes(good[:900])
    flipped = good[:middle] + bytes([good[middle] ^ 4]) + good[middle + 1 :]
    (folder / "flipped.safetensors").write_bytes(flipped)
    before = set(folder.rglob("*"))
    lines = [line.split(": ", 1) for line in cases.REFUSALS.strip().splitlines()]
    requests = [f"{first} {rest.strip()}" for first, rests in lines for rest in rests.split("|")]
    found: Entries = {}
    for name, done in run({text.strip(): text.strip() for text in requests}, folder).items():
        found |= {f"{name}/exit code": done.code, f"{name}/text": done.out + done.err}
    left = (str(file.relative_to(folder)) for file in set(folder.rglob("*")) - before)
    return found | {"files left behind": sorted(file for file in left if "__pycache__" not in file)}


def export(folder: Path) -> Entries:
    """Return the metadata of exported files and their outputs on random observations."""
    train(cases.NEEDED, folder)
    found: Entries = {}
    for name, done in run(cases.EXPORTS, folder).items():
        found[f"{name}/exit code"] = done.code
    files = [file for file in sorted(folder.glob("*.onnx")) if file.stem in cases.EXPORTS]
    for name, done in run({file.name: partial(onnx, file) for file in files}, folder).items():
        found |= document(name, done)
    scenes = [file for suffix in ("xml", "urdf") for file in folder.glob(f"*.{suffix}")]
    return found | {file.name: digest(file.read_bytes()) for file in scenes}


def onnx(file: Path) -> Entries:
    """Return metadata, inputs and outputs of a file."""
    import numpy as np
    import onnxruntime

    session = onnxruntime.InferenceSession(file)
    rng = np.random.default_rng(5)
    given = {
        one.name: rng.normal(0, 0.3, [n if isinstance(n, int) else 16 for n in one.shape])
        for one in session.get_inputs()
    }
    outputs = session.run(None, {key: value.astype(np.float32) for key, value in given.items()})
    names = [one.name for one in session.get_outputs()]
    return {
        "metadata": {k: _parsed(v) for k, v in session.get_modelmeta().custom_metadata_map.items()},
        "inputs": {one.name: [one.type, *map(str, one.shape)] for one in session.get_inputs()},
        "outputs": {k: v.astype(float).tolist() for k, v in zip(names, outputs, strict=True)},
    }


PARTS = {part.__name__: part for part in (episodes, trainings, evaluations, refusals, export)}


def compare(part: str, before: Entries, after: Entries) -> bool:
    """Print what differs; return whether an entry has changed or is missing."""
    both = before.keys() & after.keys()
    kinds = {
        "changed": [key for key in before if key in both and repr(before[key]) != repr(after[key])],
        "missing": [key for key in before if key not in both],
        "new": [key for key in after if key not in both],
    }
    counts = ", ".join(f"{len(keys)} {kind}" for kind, keys in kinds.items())
    print(f"{part}: {len(both) - len(kinds['changed'])} equal, {counts}")
    for kind, keys in kinds.items():
        for key in keys[:SHOWN]:
            texts = (json.dumps(entries[key]) for entries in (before, after) if key in entries)
            print(f"  {kind} {key}: {' → '.join(texts)}")
        if len(keys) > SHOWN:
            last = Counter(key.rpartition("/")[2] for key in keys).most_common(SHOWN)
            print(f"  {kind}, by last name: {', '.join(f'{name} {n}' for name, n in last)}")
    return bool(kinds["changed"] or kinds["missing"])


def machine() -> dict[str, str]:
    """Return what floating-point results depend on."""
    info = Path("/proc/cpuinfo")
    model = re.search(r"model name\s*: (.*)", info.read_text()) if info.exists() else None
    packages = {name: version(name) for name in ("numpy", "torch", "pymunk", "mujoco")}
    return {"cpu": model[1] if model else platform.processor(), **packages}


def measure(names: Iterable[str]) -> tuple[dict[str, Entries], dict[str, float]]:
    """Return the entries of parts, as JSON gives them back, and how long each took [s]."""
    import torch  # noqa: F401 (imported once, as what evaluations need; the processes are forked)

    import flipperctl

    flipperctl.evaluate("okada", terrain="flat", episodes=1, baselines=[], progress=False)
    found: dict[str, Entries] = {}
    seconds: dict[str, float] = {}
    with TemporaryDirectory(prefix="golden-") as name:
        for file, text in cases.FILES.items():
            Path(name, file).write_text(text)
        for part in names:
            begun = time.monotonic()
            found[part] = json.loads(json.dumps(PARTS[part](Path(name).resolve())))
            seconds[part] = round(time.monotonic() - begun, 1)
            print(f"{part}: {len(found[part])} entries, {seconds[part]} s", file=sys.stderr)
            failed = {key: code for key, code in found[part].items() if key.endswith("/exit code")}
            if any(failed.values()) and part != "refusals":
                print(f"  failed: {[key for key, code in failed.items() if code]}", file=sys.stderr)
    return found, seconds


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line; write or compare."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    doing = parser.add_mutually_exclusive_group(required=True)
    doing.add_argument("--write", type=Path, metavar="FILE")
    doing.add_argument("--compare", type=Path, metavar="FILE")
    parser.add_argument("--only", default=",".join(PARTS), help="parts; writing keeps the others")
    options = parser.parse_args(arguments)
    names = options.only.split(",")
    if unknown := set(names) - PARTS.keys():
        parser.error(f"--only: {', '.join(PARTS)} are allowed; the value has {sorted(unknown)}")
    if options.write:
        found, seconds = measure(names)
        written = json.loads(options.write.read_text()) if options.write.exists() else {}
        if written.get("machine") != machine():
            written = {"machine": machine(), "seconds": {}, "parts": {}}
        written["seconds"] |= seconds
        written["parts"] |= found
        options.write.write_text(json.dumps(written, indent=0, ensure_ascii=False))
        return 0
    before = json.loads(options.compare.read_text())
    if before["machine"] != machine():
        print(f"written on another machine: {before['machine']}; here {machine()}")
    found, _ = measure(names)
    differs = [compare(part, before["parts"].get(part, {}), found[part]) for part in names]
    return int(any(differs))


if __name__ == "__main__":
    sys.exit(main())
