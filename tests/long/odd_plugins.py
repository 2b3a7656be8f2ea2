"""Plugin files that misbehave at a given place, in a given manner, from a given call on.

In: a random generator. Out: the source of a file with one plugin, ``odd``: a template with a place
in each method, at which a statement is put in. The file touches a marker when it misbehaves, which
distinguishes the cases that never reach the place.
"""

from dataclasses import dataclass
from pathlib import Path

HEADER = """\
import asyncio, subprocess, sys, pathlib
from dataclasses import replace
from concurrent.futures.process import BrokenProcessPool
import numpy as np
import torch
from pydantic import BaseModel, Field, field_serializer, field_validator, model_validator
from flipperctl import errors
from flipperctl.api import *
from flipperctl.api import NO_LIMITS, SensedAngles, SensedGround, Shaping

class Mine(BaseException): pass
class MineToo(Exception): pass
class Two(Exception):
    def __init__(self, one, two): super().__init__(one)
class Bounded(BaseModel):
    x: int = Field(0, le=3)

def deep(n):
    return deep(n + 1) + 1

calls = 0
def due():
    global calls
    calls += 1
    if calls >= {call}:
        pathlib.Path({marker!r}).touch()
        return True
    return False

def factory():
    {factory}
    return 1.0

{on_import}
"""
COMMON = """\
    size_of: float = Field(default_factory=factory, description="any [-]")
    @model_validator(mode="after")
    def whole(self):
        {validator}
        return self
    @field_validator("size_of", mode="before")
    @classmethod
    def part(cls, value):
        {field_validator}
        return value
    @field_serializer("size_of")
    def written(self, value):
        {serialiser}
        return value
"""
BODIES = {
    "terrain": """\
@terrain("odd")
class Odd(Terrain):
{common}
    def generate(self, rng):
        {generate}
        return Profile([(0, 0), (0.3, 0)])
    def at(self, difficulty):
        {at}
        return self
    @property
    def first_difficulty(self):
        {first_difficulty}
        return 1.0
    def next_difficulty(self, difficulty, reached):
        {next_difficulty}
        return 1.0
""",
    "reward": """\
@reward("odd")
class Odd({base}):
{common}
    @property
    def bounds(self):
        {bounds}
        return (-1.0, 1.0)
    def {method}(self, *given):
        {body}
        return 0.5
""",
    "network": """\
class Net(torch.nn.Module):
    def __init__(self, size):
        super().__init__()
        self.layer = torch.nn.Linear(size, 9)
    def forward(self, x):
        {forward}
        return self.layer(x)
{more}
@network("odd")
class Odd(Network):
{common}
    @property
    def frames(self):
        {frames}
        return 1
    def build(self, layout, n_actions):
        size = layout.size
        {build}
        return Net(size)
""",
    "controller": """\
class Mind:
    def reset(self, simulator):
        {reset}
    def act(self, p):
        {act}
        return 4

@controller("odd")
class Odd(Controller):
{common}
    def build(self):
        {build}
        return Mind()
""",
    "sim": """\
class OddWorld:
    def __init__(self, x):
        self.x, self.time = x, 0.0
    @property
    def position(self):
        {position}
        return self.x, 0.1
    @property
    def pitch(self):
        {pitch}
        return 0.0
    def command(self, front, rear):
        {command}
    def advance(self, samples, limits=NO_LIMITS):
        {advance}
        poses = []
        while len(poses) < samples and not limits.reached(self.x, 0.1, 0.0):
            self.x, self.time = self.x + 0.002, self.time + 0.01
            poses.append([self.x, 0.1, 0.0, 0.0, 0.0])
        return np.array(poses)
    def state(self):
        velocity = np.array([0.2, 0.0])
        now = RobotState(np.array([self.x, 0.1]), 0.0, 0.0, 0.0, velocity, 0.0, self.time)
        {state}
        return now
    def penetration(self):
        {penetration}
        return 0.0
    def ended(self):
        {ended}
        return None
    def save(self):
        {save}
        return self.x, self.time
    def load(self, saved):
        {load}
        self.x, self.time = saved
    def draw(self, width, height):
        {draw}
        return np.zeros((height, width, 3), np.uint8)

@engine("odd")
class Odd(Engine):
{common}
    def place(self, profile, robot, start, rng):
        {place}
        return OddWorld(start.x)
    def versions(self):
        {versions}
        return {{"odd": "1"}}
    def files_read(self):
        {files_read}
        return ()

class Ahead:
    def reset(self, simulator):
        begun = simulator.save()
        simulator.step(4)
        simulator.load(begun)
    def act(self, p):
        return 4

@controller("looking")
class Looking(Controller):
    def build(self):
        return Ahead()
""",
    "perception": """\
class Eye:
    def sense(self, state, rng):
        ground = SensedGround(np.array([[0.0, -0.1], [0.5, -0.1]]), np.full(30, -0.1))
        angles = SensedAngles(state.front, state.rear, state.pitch)
        {sense}
        return ground, angles

@sensor("odd")
class Odd(Sensor):
{common}
    def over(self, profile, margin):
        {over}
        return Eye()
    def exact(self):
        {exact}
        return self
    def files_read(self):
        {files_read}
        return ()
""",
}
QUANTILES = """\
    def quantiles(self, x):
        {quantiles}
        return self.layer(x).unsqueeze(2) + torch.zeros(1, 1, 2)
"""
NOISE = """\
    def draw_noise(self, rng):
        {draw_noise}
"""
RAISED = (
    *(f"raise {name}('seven')" for name in (
        "ValueError", "TypeError", "IndexError", "KeyError", "AttributeError", "RuntimeError",
        "ZeroDivisionError", "MemoryError", "RecursionError", "StopIteration", "AssertionError",
        "NotImplementedError", "OSError", "BrokenPipeError", "EOFError", "ImportError",
        "UserWarning", "SystemExit", "GeneratorExit", "Mine", "MineToo", "asyncio.CancelledError",
        "errors.ConfigError", "errors.FlipperctlError", "BrokenProcessPool", "StopAsyncIteration",
    )),
    *("raise SystemExit", "raise SystemExit(0)", "sys.exit(0)", "sys.exit()", "exit(0)"),
    *("raise Two('a', 'b')", "raise ValueError('x' * 10**6)", "raise ValueError"),
    *("raise RuntimeError('a\\nb\\tc\\x00d')", "raise ExceptionGroup('g', [ValueError('v')])"),
    *("deep(0)", "np.zeros(10**14)", "[][3]", "{}['key']", "None.attribute", "1 / 0", "undefined"),
    *("raise subprocess.CalledProcessError(0, 'x')", "Profile('x')", "Bounded(x=7)"),
)  # fmt: skip
"""Statements that raise an exception; ``KeyboardInterrupt`` is left out, as users raise it."""

NUMBERS = ("None", "'1.0'", "float('nan')", "1j")
RETURNED = {
    ("terrain", "generate"): (
        *("None", "[(0, 0), (1, 0)]", "Profile([])", "Profile([(0, 0), (1, float('nan'))])"),
        *("Profile([(1, 0), (0, 0)])", "Profile([(-1e300, 0), (1e300, 0)])"),
        *("Profile([(0, 0), (5000, 0)])", "Profile([(0, 0), (1, 101)])"),
        "Profile(np.stack([np.linspace(0, 900, 90_000), np.arange(90_000) % 2], 1))",
    ),
    ("terrain", "at"): ("None", "Profile([(0, 0)])"),
    ("terrain", "first_difficulty"): (*NUMBERS, "2.0"),
    ("terrain", "next_difficulty"): ("None", "2.0"),
    ("reward", "__call__"): (*NUMBERS, "np.zeros(3)", "1e300", "7.0"),
    ("reward", "bounds"): ("None", "(1.0, 0.0)", "(0.0,)"),
    ("network", "build"): (
        *("None", "torch.nn.Linear", "torch.nn.Linear(size, 4)", "torch.nn.LSTM(size, 9)"),
        *("torch.nn.Linear(size, 9).half()", "lambda x: x"),
        "torch.nn.Sequential(torch.nn.BatchNorm1d(size), torch.nn.Linear(size, 9))",
        "torch.nn.Sequential(torch.nn.Linear(size, 10**6), torch.nn.Linear(10**6, 10**6))",
    ),
    ("network", "forward"): (
        *("None", "torch.zeros(len(x), 3)", "(x, x)", "torch.full((len(x), 9), float('nan'))"),
    ),
    ("network", "frames"): ("0", "'2'", "2.0"),
    ("network", "quantiles"): ("None", "torch.zeros(len(x), 9)"),
    ("sim", "place"): ("None", "Odd"),
    ("sim", "position"): ("None", "(1.0,)", "('a', 'b')", "(float('nan'), 0.0)", "(10**400, 0)"),
    ("sim", "pitch"): NUMBERS,
    ("sim", "advance"): (
        *("None", "np.empty((0, 5))", "np.zeros((samples, 4))", "np.zeros((samples + 1, 5))"),
        *("np.zeros((samples, 5), object)", "np.full((samples, 5), np.nan)", "(p for p in ())"),
    ),
    ("sim", "state"): (
        *("None", "RobotState", "replace(now, pitch=float('nan'))", "replace(now, time='x')"),
        *("replace(now, position=np.zeros(3))", "replace(now, velocity=np.array([np.inf, 0]))"),
        *("replace(now, front=None)", "replace(now, pitch=10**400)"),
    ),
    ("sim", "penetration"): ("None", "float('nan')"),
    ("sim", "ended"): ("'reached'", "True", "Outcome"),
    ("sim", "draw"): ("None", "np.zeros((3, 3), np.uint8)", "np.zeros((height, width, 3))"),
    ("sim", "versions"): ("None", "{'a': 1}"),
    ("sim", "files_read"): ("None", "('x',)"),
    ("perception", "over"): ("None", "Odd"),
    ("perception", "sense"): (
        *("None", "(ground,)", "(angles, ground)", "(SensedGround, SensedAngles)"),
        *("(replace(ground, points=np.zeros(4)), angles)", "(g for g in ())"),
        *("(replace(ground, heights=np.zeros(1)), angles)", "(ground, (0.0, 0.0, 0.0))"),
        "(replace(ground, heights=np.full(30, np.inf)), angles)",
        "(replace(ground, filled=np.zeros(3, bool)), angles)",
        *("(ground, replace(angles, front=None))", "(ground, replace(angles, pitch=float('nan')))"),
    ),
    ("perception", "exact"): ("None", "Odd(bins=3)"),
    ("perception", "files_read"): ("None", "('x',)"),
    ("controller", "build"): ("None", "Controller"),
    ("controller", "act"): ("None", "4.5", "9", "True", "np.array([4])", "float('nan')"),
}
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
