"""Templates of plugin files with a place in each method, at which a statement is put in."""

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
class Mute(Exception):
    def __str__(self): raise SystemExit(0)
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
        ground = SensedGround(np.array([[0.0, -0.1], [0.5, -0.1]]), np.full(15, -0.1))
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
