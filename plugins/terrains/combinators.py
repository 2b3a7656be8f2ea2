"""Terrains that are composed of other terrains."""

from dataclasses import replace
from itertools import pairwise
from typing import Any, Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import (
    AnyTerrain,
    FloatArray,
    IntRange,
    MirroredSurface,
    Plugin,
    Profile,
    Range,
    Terrain,
    terrain,
)

from .obstacles import CurbAndRamp, Gap, Ramp, Step, Uplift
from .rough import Rough
from .rows import Pallet, Plum
from .stairs import Stair, Stairwell


def terrain_field(default: Terrain) -> Any:
    """Return the field of a terrain within another one."""
    return Field(
        default, description="the terrain: a name, or a mapping with a name and fields [-]"
    )


def parts_field(default: tuple[Terrain, ...]) -> Any:
    """Return the field of several terrains within another one."""
    text = "the terrains: names, or mappings with a name and fields [-]"
    return Field(default, min_length=1, description=text)


def weights_field(default: tuple[float, ...] = ()) -> Any:
    """Return the field of the frequencies of ``parts``."""
    text = "relative frequency of each part; equal for all if empty [-]"
    return Field(default, description=text)


class Combinator(Terrain):
    """Pass its difficulty on to each of the terrains in its fields."""

    def _inner(self) -> dict[str, Terrain | tuple[Terrain, ...]]:
        values = {name: getattr(self, name) for name in type(self).model_fields}
        return {
            name: value
            for name, value in values.items()
            if isinstance(value, Terrain)
            or (isinstance(value, tuple) and any(isinstance(item, Terrain) for item in value))
        }

    def _terrains(self) -> list[Terrain]:
        groups = self._inner().values()
        return [t for group in groups for t in (group if isinstance(group, tuple) else (group,))]

    @property
    def title(self) -> str:
        """The plugin's name, with the recorded file if that is the only inner terrain."""
        inner, *others = self._terrains()
        recorded = not others and inner.title != inner.plugin_name
        return f"{self.plugin_name} of {inner.title}" if recorded else self.plugin_name

    @property
    def first_difficulty(self) -> float:
        """Smallest first difficulty of the inner terrains [-]."""
        return min(part.first_difficulty for part in self._terrains())

    def next_difficulty(self, difficulty: float, reached: bool) -> float:
        """Return the next difficulty of the first inner terrain that changes it."""
        following = [part.next_difficulty(difficulty, reached) for part in self._terrains()]
        return next((value for value in following if value != difficulty), difficulty)

    def at(self, difficulty: float) -> Self:
        """Return this terrain with every inner terrain configured for ``difficulty``."""
        inner = {
            name: tuple(part.at(difficulty) for part in value)
            if isinstance(value, tuple)
            else value.at(difficulty)
            for name, value in self._inner().items()
        }
        return self.model_copy(update=inner)


@terrain("mix")
class Mix(Combinator):
    """One of several terrains each episode; the episode's row names it."""

    parts: tuple[AnyTerrain, ...] = parts_field((Step(), Stair()))
    weights: tuple[float, ...] = weights_field()

    @model_validator(mode="after")
    def _check_weights(self) -> Self:
        if self.weights and len(self.weights) != len(self.parts):
            raise ValueError(
                f"{len(self.weights)} weights for {len(self.parts)} parts; give one each, or none"
            )
        if self.weights and (min(self.weights) < 0 or sum(self.weights) <= 0):
            raise ValueError(f"weights {self.weights} must not be negative, nor all 0")
        return self

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the profile of the drawn part, with that part's label."""
        return self.parts[self.draw_part(rng)].labelled(rng)

    def draw_part(self, rng: np.random.Generator) -> int:
        """Draw the index of a part by the weights."""
        weights = np.array(self.weights or [1.0] * len(self.parts))
        return int(rng.choice(len(self.parts), p=weights / weights.sum()))


@terrain("mirror")
class Mirror(Combinator):
    """Another terrain, crossed from its end to its start."""

    terrain: AnyTerrain = terrain_field(CurbAndRamp())
    probability: float = Field(
        1.0, ge=0, le=1, description="probability that an episode's terrain is reversed [-]"
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the points in reverse order, beginning at (0, 0), with the same label.

        The values that the inner terrain drew describe it before the reversal. ``mirrored`` is 1 if
        the whole is reversed, by one mirror or by an odd number.
        """
        profile = self.terrain.labelled(rng)
        if rng.random() >= self.probability:
            return replace(profile, drawn={"mirrored": 0, **profile.drawn})
        # The last point becomes the first, and the ends exchange their distances.
        last = profile.points[-1]
        surface = profile.surface and MirroredSurface(profile.surface, (last[0], last[1]))
        drawn = {**profile.drawn, "mirrored": 1 - profile.drawn.get("mirrored", 0)}
        points = (profile.points[::-1] - last) * (-1.0, 1.0)
        return replace(
            profile,
            points=points,
            surface=surface,
            drawn=drawn,
            run_up=profile.run_out,
            run_out=profile.run_up,
        )


@terrain("noisy")
class Noisy(Combinator):
    """Another terrain with a rough surface; vertical faces stay vertical."""

    terrain: AnyTerrain = terrain_field(Stair())
    deviation: float = Field(
        0.01,
        ge=0,
        le=0.1,
        description="standard deviation of the heights at the knots; the surface between them has "
        "1 / 1.22 of it [m]",
    )
    correlation: float = Field(
        0.1, ge=0.02, le=5, description="distance between independent heights of the surface [m]"
    )
    margin: float = Field(
        0.5, ge=0, le=5, description="length of rough ground before and past the terrain [m]"
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the surface plus linearly interpolated noise, drawn every ``correlation`` [m]."""
        profile = self.terrain.labelled(rng)
        line = profile.extended(self.margin, self.margin)
        knots = np.arange(line[0, 0], line[-1, 0] + self.correlation, self.correlation)
        noise = rng.normal(0.0, self.deviation, len(knots))
        points = _with_knots(line, knots)
        # Both ends of a vertical face get the same noise.
        rough = np.interp(points[:, 0], knots, noise)
        points = points + np.column_stack([np.zeros(len(points)), rough])
        run_up, run_out = (
            None if end is None else end - self.margin for end in (profile.run_up, profile.run_out)
        )
        return replace(profile, points=points, surface=None, run_up=run_up, run_out=run_out)


def _with_knots(line: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the polyline with points added at every knot within a segment, (V', 2) [m]."""
    pieces = []
    for (x0, z0), (x1, z1) in pairwise(line):
        inner = knots[(knots > x0) & (knots < x1)]
        heights = np.interp(inner, (x0, x1), (z0, z1))
        pieces += [np.array([[x0, z0]]), np.column_stack([inner, heights])]
    return np.vstack([*pieces, line[-1:]])


STARTS = ("start_on", "finish_on")
"""Numbers that ``midway`` draws, which mean nothing where the ground is a part of other ground."""


@terrain("midway")
class Midway(Combinator):
    """Another terrain, with start or finish on it, wherever the robot can stand.

    The robot then starts with the pitch that a slope or a stair gives it, and an episode may end on
    a slope. On ground shorter than ``shortest`` it starts before the first edge and finishes past
    the last, as elsewhere.
    """

    terrain: AnyTerrain = terrain_field(Stairwell())
    start: float = Field(
        0.5, ge=0, le=1, description="probability that an episode starts on the terrain [-]"
    )
    finish: float = Field(
        0.5, ge=0, le=1, description="probability that an episode finishes on the terrain [-]"
    )
    shortest: float = Field(
        1.5,
        ge=0.5,
        le=100,
        description="shortest way on the terrain from the start to the finish [m]",
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the inner profile with its label and a start and a finish of its own."""
        profile = self.terrain.labelled(rng)
        starts, finishes = rng.random() < self.start, rng.random() < self.finish
        # All places between the edges from which ``shortest`` is left are equally probable.
        spare = profile.end - profile.start - self.shortest
        places = np.sort(rng.random(2)) * spare if starts and finishes else rng.random(2) * spare
        before = float(places[0]) if starts and spare > 0 else None
        behind = float(spare - places[1]) if finishes and spare > 0 else None
        drawn = {name: value for name, value in profile.drawn.items() if name not in STARTS}
        drawn |= {} if before is None else {"start_on": before}
        drawn |= {} if behind is None else {"finish_on": behind}
        return replace(
            profile,
            run_up=None if before is None else -before,
            run_out=None if behind is None else -behind,
            drawn=drawn,
        )


@terrain("excerpt")
class Excerpt(Combinator):
    """A piece of another terrain or of a long recording, level at both ends.

    One recorded file thus gives as many episodes as it has places to begin at. Ground that is
    shorter than the piece is returned whole; the ground beside the line of a recording is left out.
    """

    terrain: AnyTerrain = terrain_field(Rough())
    length: Range = Field(Range(2.0, 5.0), gt=0.1, le=100, description="length of the piece [m]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the points of the piece and its interpolated ends, with the inner label."""
        profile = self.terrain.labelled(rng)
        whole = profile.end - profile.start
        # Every place at which the whole piece fits is equally probable.
        length = min(self.length.sample(rng), whole)
        first = profile.start + rng.random() * (whole - length)
        points = profile.points if length == whole else _piece(profile, first, first + length)
        known = {name: value for name, value in profile.drawn.items() if name not in STARTS}
        drawn = {**known, "piece_start": first - profile.start, "piece_length": length}
        return Profile(points, profile.label, drawn=drawn)


def _piece(profile: Profile, first: float, last: float) -> FloatArray:
    """Return the points between two x [m] with the interpolated ends, (V, 2)."""
    x, _ = profile.points.T
    inner = profile.points[(x > first) & (x < last)]
    ends = [(at, profile.height(at)) for at in (first, last)]
    return np.vstack([ends[:1], inner, ends[1:]])


@terrain("sequence")
class Sequence(Combinator):
    """Terrains one after another; each begins at the height where the last ended."""

    parts: tuple[AnyTerrain, ...] = Field(
        (Ramp(), Step()),
        min_length=1,
        description="the terrains in order: names, or mappings with a name and fields [-]",
    )
    spacing: Range = Field(
        Range(0.5, 1.5), ge=0, le=20, description="level ground between two terrains [m]"
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the points of all parts, with their labels and what they drew."""
        end, points, labels = np.zeros(2), [], []
        drawn: dict[str, float] = {}
        for index, part in enumerate(self.parts):
            if index:
                end = end + np.array([self.spacing.sample(rng), 0.0])
            profile = part.labelled(rng)
            points.append(profile.points - profile.points[0] + end)
            labels.append(profile.label)
            for name, value in profile.drawn.items():
                if name not in STARTS:  # the sequence has its own start and finish
                    drawn[f"part{index + 1}_{name}"] = value
            end = points[-1][-1]
        return Profile(np.vstack(points), "+".join(labels), drawn=drawn)


@terrain("course")
class Course(Mix):
    """Several obstacles in a row, their number, kinds and sizes sampled.

    Each obstacle begins at the height at which the previous one ended. The drawn values are the
    number of obstacles, and the index of each one's kind within ``parts``.
    """

    parts: tuple[AnyTerrain, ...] = parts_field(
        (Step(), Stair(), Ramp(), Gap(), Uplift(), Pallet(), Plum())
    )
    obstacles: IntRange = Field(IntRange(2, 5), ge=1, le=10, description="number of obstacles [-]")
    spacing: Range = Field(
        Range(0.3, 1.5), ge=0, le=20, description="level ground between two obstacles [m]"
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the points of all obstacles."""
        obstacles = self.obstacles.sample(rng)
        drawn: dict[str, float] = {"obstacles": obstacles}
        end, points = np.zeros(2), []
        for place in range(1, obstacles + 1):
            if place > 1:
                end = end + np.array([self.spacing.sample(rng), 0.0])
            kind = self.draw_part(rng)
            obstacle = self.parts[kind].labelled(rng).points
            points.append(obstacle - obstacle[0] + end)
            end = points[-1][-1]
            drawn[f"kind{place}"] = kind
        return Profile(np.vstack(points), drawn=drawn)


@terrain("curriculum")
class Curriculum(Terrain):
    """In training, move from an easy to a hard version of a terrain with each success.

    Every number is interpolated linearly between its easy and its hard value by the difficulty;
    validation and evaluation use the hard version. The difficulty settles where the success rate
    is down / (up + down), 75 % at the defaults. ``metrics.csv`` has each episode's difficulty.
    """

    easy: AnyTerrain = Field(
        Step(height=Range(-0.1, 0.1)),
        description="the terrain at difficulty 0, with its fields [-]",
    )
    hard: AnyTerrain = Field(
        Step(), description="the same terrain at difficulty 1; only numbers may differ [-]"
    )
    start: float = Field(0.0, ge=0, le=1, description="difficulty of the first episode [-]")
    up: float = Field(0.01, ge=0, le=1, description="increase of difficulty after a success [-]")
    down: float = Field(0.03, ge=0, le=1, description="decrease of difficulty after a failure [-]")

    @model_validator(mode="after")
    def _check_interpolable(self) -> Self:
        self.at(0.5)
        return self

    @property
    def first_difficulty(self) -> float:
        """Difficulty of the first episode [-]."""
        return self.start

    def next_difficulty(self, difficulty: float, reached: bool) -> float:
        """Return the difficulty, raised after a success or else lowered, within 0 and 1."""
        return min(1.0, max(0.0, difficulty + (self.up if reached else -self.down)))

    def at(self, difficulty: float) -> Terrain:
        """Return the terrain between easy and hard.

        Raises:
            ValueError: the difficulty is not within 0 and 1.
        """
        if not 0 <= difficulty <= 1:
            raise ValueError(f"difficulty {difficulty:g} is not within 0 and 1")
        between: Terrain = _between(self.easy, self.hard, difficulty, self.easy.plugin_name)
        return between

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return a profile of the hard version."""
        return self.hard.labelled(rng)


def _between(easy: Any, hard: Any, fraction: float, where: str) -> Any:
    """Interpolate from ``easy`` (fraction 0) to ``hard`` (fraction 1); integers stay integers."""
    if easy == hard:
        return hard
    # Plugins and tuples are interpolated field by field.
    if type(easy) is type(hard) and isinstance(easy, Plugin):
        fields = type(easy).model_fields
        values = {
            f: _between(getattr(easy, f), getattr(hard, f), fraction, f"{where}.{f}")
            for f in fields
        }
        return type(easy)(**values)
    if isinstance(easy, tuple) and isinstance(hard, tuple) and len(easy) == len(hard):
        pairs = enumerate(zip(easy, hard, strict=True))
        return tuple(_between(a, b, fraction, f"{where}.{i}") for i, (a, b) in pairs)
    if type(easy) is type(hard) and isinstance(easy, int | float) and not isinstance(easy, bool):
        value = easy * (1 - fraction) + hard * fraction
        return round(value) if isinstance(easy, int) else value
    raise ValueError(
        f"only numbers may differ between easy and hard; {where} is {_shown(easy)} and "
        f"{_shown(hard)}"
    )


def _shown(value: object) -> str:
    return value.plugin_name if isinstance(value, Plugin) else repr(value)
