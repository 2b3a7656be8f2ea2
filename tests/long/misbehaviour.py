"""Plugin files that misbehave at a given place, in a given manner, from a given call on.

In: a random generator. Out: the source of a file with one plugin, ``odd``. The file touches a
marker when it misbehaves, which distinguishes the cases that never reach the place.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.long.odd_plugins import BODIES, COMMON, HEADER, NOISE, QUANTILES

RAISED = (
    *(f"raise {name}('seven')" for name in (
        "ValueError", "TypeError", "IndexError", "KeyError", "AttributeError", "RuntimeError",
        "ZeroDivisionError", "MemoryError", "RecursionError", "StopIteration", "AssertionError",
        "NotImplementedError", "OSError", "BrokenPipeError", "EOFError", "ImportError",
        "UserWarning", "SystemExit", "GeneratorExit", "Mine", "MineToo", "asyncio.CancelledError",
        "errors.ConfigError", "errors.FlipperctlError", "BrokenProcessPool", "StopAsyncIteration",
    )),
    *("raise SystemExit", "raise SystemExit(0)", "sys.exit(0)", "sys.exit()", "exit(0)"),
    *("raise Two('a', 'b')", "raise Mute", "raise ValueError('x' * 10**6)", "raise ValueError"),
    *("raise RuntimeError('a\\nb\\tc\\x00d')", "raise ExceptionGroup('g', [ValueError('v')])"),
    *("deep(0)", "np.zeros(10**14)", "[][3]", "{}['key']", "None.attribute", "1 / 0", "undefined"),
    *("raise subprocess.CalledProcessError(0, 'x')", "Profile('x')", "Bounded(x=7)"),
)  # fmt: skip
"""Statements that raise an exception; ``KeyboardInterrupt`` is left out, as users raise it."""

BAD_NUMBERS = ("None", "'1.0'", "[1.0]", "object()", "1j", "float('nan')", "float('inf')", "{}")
RETURNED = {
    ("terrain", "generate"): (
        *("None", "'x'", "3", "[]", "[(0, 0), (1, 0)]", "Profile", "{}", "Profile([])"),
        *("Profile([(0, 0), (1e300, 0)])", "Profile([(0, 0), (1, 1e300)])", "(p for p in ())"),
        *("Profile([(0, 0), (1, -1e300)])", "Profile([(-1e300, 0), (1e300, 0)])"),
        *("Profile([(0, 0), (1, float('nan'))])", "Profile([(0, 0), (float('inf'), 0)])"),
        *("Profile([(1, 0), (0, 0)])", "Profile([(1e12, 0), (1e12, 1)])", "Profile([1, 2])"),
        *("Profile([(0, 0), (5000, 0)])", "Profile([(0, 0), (1, 101)])", "Profile([(0, 0)], 5)"),
        "Profile(np.stack([np.linspace(0, 900, 90_000), np.arange(90_000) % 2], 1))",
    ),
    ("terrain", "at"): ("None", "'flat'", "3", "Profile([(0, 0)])"),
    ("terrain", "first_difficulty"): (*BAD_NUMBERS, "2.0", "-0.1"),
    ("terrain", "next_difficulty"): (*BAD_NUMBERS, "2.0", "-0.1"),
    ("reward", "__call__"): (*BAD_NUMBERS, "np.zeros(3)", "-float('inf')", "1e300", "7.0", "(1,)"),
    ("reward", "bounds"): ("None", "(1.0, 0.0)", "3", "('a', 'b')", "(0.0,)", "(float('nan'), 1)"),
    ("network", "build"): (
        *("None", "'net'", "5", "torch.nn.Linear", "torch.nn.Linear(size, 4)"),
        *("torch.nn.Identity()", "torch.nn.Linear(5, 9)", "torch.nn.LSTM(size, 9)"),
        "torch.nn.Linear(size, 9).half()",
        *("torch.nn.Sequential(torch.nn.BatchNorm1d(size), torch.nn.Linear(size, 9))",),
        "lambda x: x",
        "torch.nn.Sequential(torch.nn.Linear(size, 10**6), torch.nn.Linear(10**6, 10**6))",
    ),
    ("network", "forward"): (
        *("None", "'q'", "7", "torch.zeros(len(x), 3)", "torch.zeros(1)", "(x, x)"),
        *("torch.zeros(())", "torch.full((len(x), 9), float('nan'))"),
        "torch.full((len(x), 9), float('inf'))",
    ),
    ("network", "frames"): ("0", "33", "'2'", "None", "1e300", "2.0", "-1"),
    ("network", "quantiles"): ("None", "torch.zeros(1)", "torch.zeros(len(x), 9)", "'q'"),
    ("sim", "place"): ("None", "'x'", "3", "object()", "Odd", "(1, 2)", "np.zeros(3)"),
    ("sim", "position"): (
        *("None", "'x'", "'ab'", "3.0", "(1.0,)", "(1, 2, 3)", "(None, None)", "('a', 'b')"),
        *("(float('nan'), 0.0)", "(0.0, float('inf'))", "(1j, 0.0)", "(10**400, 0)", "{}"),
    ),
    ("sim", "pitch"): BAD_NUMBERS,
    ("sim", "advance"): (
        *("None", "'x'", "3", "[]", "np.empty((0, 5))", "np.zeros(5)", "np.zeros((samples, 4))"),
        *("np.zeros((samples + 1, 5))", "np.zeros((samples, 5, 1))", "np.array(1.0)"),
        *("np.zeros((samples, 5), complex)", "np.zeros((samples, 5), object)"),
        *( "np.array([['a'] * 5])", "[[0.0] * 5] * samples"),
        *("np.full((samples, 5), np.nan)", "np.full((1, 5), np.inf)", "(p for p in ())"),
    ),
    ("sim", "state"): (
        *("None", "'x'", "3", "(1, 2)", "RobotState", "replace(now, pitch=float('nan'))"),
        *("replace(now, position=None)", "replace(now, position=[0.0, 0.1])"),
        *("replace(now, time='x')", "replace(now, pitch=10**400)"),
        *("replace(now, position=np.zeros(3))", "replace(now, velocity=np.zeros((2, 1)))"),
        *("replace(now, velocity=np.array([np.inf, 0]))", "replace(now, front=None)"),
        *("replace(now, roll=float('inf'))", "replace(now, rear=1j)"),
    ),
    ("sim", "penetration"): BAD_NUMBERS,
    ("sim", "ended"): ("'reached'", "3", "True", "object()", "float('nan')", "Outcome", "()"),
    ("sim", "draw"): (
        *("None", "'x'", "np.zeros((3, 3), np.uint8)", "np.zeros((width, height, 3), np.uint8)"),
        *("np.zeros((height, width, 3))", "np.zeros((height, width), np.uint8)", "[]"),
    ),
    ("sim", "versions"): ("None", "'x'", "3", "{'a': 1}", "{1: 'a'}", "['a']"),
    ("sim", "files_read"): ("None", "3", "('x',)", "'x'", "(None,)"),
    ("perception", "over"): ("None", "'x'", "3", "object()", "Odd", "np.zeros(3)"),
    ("perception", "sense"): (
        *("None", "'x'", "3", "()", "(ground,)", "(ground, angles, 1)", "(angles, ground)"),
        *("(None, None)", "(SensedGround, SensedAngles)", "(replace(ground, points=None), angles)"),
        "(replace(ground, points=np.zeros(4)), angles)",
        "(replace(ground, heights=0.0), angles)",
        *("(replace(ground, points=np.full((4, 2), np.nan)), angles)", "(ground, (0.0, 0.0, 0.0))"),
        "(replace(ground, heights=np.zeros(1)), angles)",
        "(replace(ground, heights=[0.0]), angles)",
        "(replace(ground, heights=np.full(15, np.inf)), angles)",
        "(ground, replace(angles, rear=1j))",
        *("(replace(ground, heights=np.array(['a'] * 15)), angles)", "(g for g in ())"),
        "(replace(ground, filled=np.zeros(3, bool)), angles)",
        "(replace(ground, filled=3), angles)",
        *("(ground, replace(angles, front=None))", "(ground, replace(angles, pitch=float('nan')))"),
        *("(ground, replace(angles, pitch='x'))", "(ground, replace(angles, rear=np.zeros(2)))"),
    ),
    ("perception", "exact"): ("None", "'x'", "3", "Odd", "Odd(bins=3)"),
    ("perception", "files_read"): ("None", "3", "('x',)"),
    ("controller", "build"): ("None", "'mind'", "4", "Controller", "object()"),
    ("controller", "act"): (
        *("None", "'4'", "4.5", "9", "-1", "True", "np.float64(4)", "np.array([4])", "[4]"),
        *("float('nan')", "1e300", "object()", "10**30", "()", "np.array([1, 2])"),
    ),
}  # fmt: skip
"""Kind and method → expressions that it must not return; the templates define ``size``, ``x``."""

SPOTS = {
    "terrain": ("generate", "at", "first_difficulty", "next_difficulty"),
    "reward": ("__call__", "bounds", "potential"),
    "network": ("build", "forward", "frames", "quantiles", "draw_noise"),
    "controller": ("build", "reset", "act"),
    "sim": (
        *("place", "position", "pitch", "command", "advance", "state", "penetration", "ended"),
        *("save", "load", "draw", "versions", "files_read"),
    ),
    "perception": ("over", "sense", "exact", "files_read"),
}
OFTEN = (
    *("__call__", "potential", "act", "forward", "draw_noise"),
    *("position", "pitch", "command", "advance", "state", "ended", "sense"),
)
"""Methods that are called so often that they may misbehave later than at the first call."""
BEFORE = ("import", "factory", "validator", "field validator", "serialiser")
"""Places that every kind of plugin has."""


@dataclass(frozen=True)
class Misbehaviour:
    """The kind of a plugin, and where, how and from which call on it misbehaves."""

    kind: str
    spot: str
    statement: str
    call: int

    def source(self, marker: Path) -> str:
        """Return the source of the plugin file."""
        spots = (*BEFORE, *(spot for found in SPOTS.values() for spot in found))
        key = self.spot.replace(" ", "_")
        filled = {spot.replace(" ", "_"): "pass" for spot in spots}
        filled[key] = f"if due(): {self.statement}"
        header = HEADER.format(
            call=self.call, marker=str(marker), factory=filled["factory"],
            on_import=filled["import"],
        )  # fmt: skip
        common = COMMON.format(**filled)
        shaping = self.spot == "potential"
        more = {"quantiles": QUANTILES, "draw_noise": NOISE}.get(self.spot, "")
        body = BODIES[self.kind].format(
            common=common,
            base="Shaping" if shaping else "RewardTerm",
            method="potential" if shaping else "__call__",
            body=filled["potential" if shaping else "__call__"],
            more=more.format(**filled),
            **{name: text for name, text in filled.items() if name != "__call__"},
        )
        return header + body

    def __str__(self) -> str:
        return f"{self.kind} {self.spot}: {self.statement[:60]} (call {self.call})"


def sample_misbehaviour(rng: np.random.Generator, kind: str) -> Misbehaviour:
    """Return a random misbehaviour of a plugin of one kind."""
    early = rng.random() < 0.25
    spot = str(rng.choice(BEFORE if early else SPOTS[kind]))
    returned = RETURNED.get((kind, spot), ())
    if returned and rng.random() < 0.5:
        statement = f"return {rng.choice(returned)}"
    else:
        statement = str(rng.choice(RAISED))
    call = int(rng.choice([1, 2, 5, 12])) if spot in OFTEN else 1
    return Misbehaviour(kind, spot, statement, call)
