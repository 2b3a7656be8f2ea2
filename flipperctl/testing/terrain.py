"""Checks of a terrain: valid profiles, repeatability, extent, difficulty, start and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from flipperctl.api import Profile, Range, Robot, Terrain
from flipperctl.config import EnvConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.ground import MOST_POINTS, generate_profile
from flipperctl.errors import ConformanceError, TerrainError
from flipperctl.figures.figure import save
from flipperctl.figures.render import CHASSIS, EARTH, Renderer
from flipperctl.figures.terrain import SMALL, terrain_figure
from flipperctl.plugging.randomness import global_states, moved_since
from flipperctl.testing.check import Variant, of, require
from flipperctl.testing.recorded import HOLD, NoReward
from flipperctl.text.files import make_folder

_MIN_AREA = 1e-3
"""Smallest fraction of the picture that ground and chassis must each cover [-]."""
SEEDS = range(5)
MAX_LENGTH, MAX_HEIGHT = 100.0, 20.0
"""Largest length of a profile, and largest height above or below its first edge [m]."""
_DRAWS = 25
"""Number of seeds over which a ground must vary, were it one of two kinds [-]."""
DECISIONS = 5
"""Number of decisions with held flippers: 0.6 m, the last third with front flippers on the
terrain [-]."""
MIN_DRIVEN, MAX_DEPTH = 0.15, 0.02
"""Smallest distance driven in these decisions, and largest penetration by contact [m]."""


@of("terrain", "profiles")
def profiles(terrain: Terrain) -> None:
    """Check that equal generators alone give equal profiles, not too long or high for a robot."""
    # The seeds are drawn once, then again in the other order and by an equal terrain.
    before = global_states()
    drawn = [_draw(terrain, seed) for seed in SEEDS]
    moved = moved_since(before)
    require(not moved, f"generate draws from {moved}; only rng is allowed")
    again = type(terrain)(**dict(terrain))
    for seed in reversed(SEEDS):
        for instance in (terrain, again):
            require(
                _draw(instance, seed).points.tobytes() == drawn[seed].points.tobytes(),
                f"two profiles from generators of seed {seed} differ; "
                "every random choice must come from rng",
            )

    # Not too long or high for a robot
    for profile in drawn:
        length = profile.end - profile.start
        require(
            length <= MAX_LENGTH, f"it is {length:g} m long; at most {MAX_LENGTH:g} m is allowed"
        )
        highest = float(np.abs(profile.points[:, 1] - profile.points[0, 1]).max())
        require(
            highest <= MAX_HEIGHT,
            f"it reaches {highest:g} m above or below its first edge; {MAX_HEIGHT:g} m is allowed",
        )


@of("terrain", "varies", everywhere=False)
def varies(terrain: Terrain) -> None:
    """Check that the ground of a terrain with sampled settings varies over the seeds."""
    # A terrain that seeds its generator anew would leave equal states.
    generators = [np.random.default_rng(seed) for seed in range(_DRAWS)]
    grounds = {_generated(terrain, rng, at).points.tobytes() for at, rng in enumerate(generators)}
    states = {repr(generator.bit_generator.state) for generator in generators}
    require(
        len(states) == _DRAWS,
        "generate leaves generators of unequal seeds in equal states; it may only draw from rng",
    )

    # A range of settings must show in the ground.
    sampled = [
        name for name, value in terrain if isinstance(value, Range) and value.low < value.high
    ]
    require(
        not sampled or len(grounds) > 1,
        f"its ground is the same for {_DRAWS} seeds, although {', '.join(sampled)} is sampled; "
        "every call of generate must draw it from rng",
    )


@of("terrain", "difficulty")
def graded(terrain: Terrain) -> None:
    """Check that difficulties from 0 to 1 work and are followed by such."""
    for difficulty in (0.0, terrain.first_difficulty, 1.0):
        for reached in (False, True):
            following = terrain.next_difficulty(difficulty, reached)
            require(
                0 <= difficulty <= 1 and 0 <= following <= 1,
                f"difficulty {difficulty:g} leads to {following:g}; 0 to 1 is allowed",
            )
        generate_profile(terrain, np.random.default_rng(0), difficulty)
    hardest = terrain.at(1.0)
    for seed in SEEDS:
        require(
            _draw(hardest, seed).points.tobytes() == _draw(terrain, seed).points.tobytes(),
            f"at(1) has other ground than the terrain itself with seed {seed}; at difficulty 1 it "
            "must be unchanged",
        )


@of("terrain", "start")
def starts(terrain: Terrain) -> None:
    """Check that the robot starts ahead of the terrain and drives off without penetrating it."""
    # The chassis never enters the ground, and the robot gets going.
    env = _environment(terrain)
    for seed in SEEDS[:2]:
        try:
            env.reset(seed=seed)
        except TerrainError as error:
            raise ConformanceError(str(error)) from error
        start = env.state.position[0]
        for decision in range(DECISIONS):
            observation, *_ = env.step(HOLD)
            require(
                env.observation_space.contains(observation),
                f"the heights perceived {decision + 1} decisions after the start lie outside "
                "the observation space, ± 100 m",
            )
            x, z = env.state.position.tolist()
            depth = max(env.drive.world.penetration(), env.profile.height(x) - z)
            require(
                depth <= MAX_DEPTH, f"the robot is {depth:.3f} m in the ground at x = {x:.2f} m"
            )
        driven = env.state.position[0] - start
        require(
            driven >= MIN_DRIVEN,
            f"the robot drove {driven:.2f} m in its first {DECISIONS} decisions; "
            f"on ground that it can cross it drives {MIN_DRIVEN:g} m or more",
        )


@of("terrain", "picture", everywhere=False)
def picture(terrain: Terrain) -> None:
    """Check that ground and robot are visible in a video frame."""
    env = _environment(terrain)
    env.reset(seed=0)
    from matplotlib.colors import to_rgb  # once flipperctl.figures has imported matplotlib

    picture = Renderer()(env.scene).astype(int)
    for what, colour in (("ground", EARTH), ("robot", CHASSIS)):
        near = np.abs(picture - np.round(255 * np.array(to_rgb(colour)))).max(axis=2) <= 8
        require(float(near.mean()) >= _MIN_AREA, f"its picture shows no {what} (in {colour})")


def _environment(terrain: Terrain) -> FlipperEnv:
    # NoReward is not a registered plugin, so that none is needed.
    return FlipperEnv(config=EnvConfig(terrain=terrain, rewards={"none": NoReward()}))


def write_pictures(variants: Sequence[Variant], folder: Path) -> None:
    """Draw the first variant large and the others small, thirteen per file."""
    name = variants[0].plugin.plugin_name
    for page, first in enumerate(range(0, len(variants), SMALL + 1)):
        shown = variants[first : first + SMALL + 1]
        profiles = [_draw(v.plugin, 0) for v in shown if isinstance(v.plugin, Terrain)]
        labels = [v.label for v in shown]
        figure = terrain_figure(profiles, Robot(), labels)
        save(figure, make_folder(folder) / f"{name}{f'_{page + 1}' if page else ''}.png", name)


def _draw(terrain: Terrain, seed: int) -> Profile:
    return _generated(terrain, np.random.default_rng(seed), seed)


def _generated(terrain: Terrain, rng: np.random.Generator, seed: int) -> Profile:
    try:
        profile = terrain.generate(rng)
    except ValueError as error:
        raise ConformanceError(f"generate raises with seed {seed}: {error}") from error
    require(
        isinstance(profile, Profile),
        f"generate returns a {type(profile).__name__}; it must return a Profile",
    )
    require(
        len(profile.points) <= MOST_POINTS,
        f"its profile has {len(profile.points):,} points; at most {MOST_POINTS:,} are allowed",
    )
    return profile
