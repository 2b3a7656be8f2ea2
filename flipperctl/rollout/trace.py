"""Traces of episodes: what pictures, players and reports show of an episode, in one small file.

In: the transitions of an episode, or a file of traces. Out: ``Trace``, poses at 20 Hz and what the
policy perceived at each decision; a .npz file without pickle, which a browser or pandas can read.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl.api import (
    FloatArray,
    Outcome,
    Perception,
    Profile,
    RobotGeometry,
    RobotState,
    Transition,
)
from flipperctl.core.targets import by_joint, means
from flipperctl.errors import RequestError, other_format
from flipperctl.text.files import write_bytes

FILE = "traces.npz"
"""Its name in a folder of ``eval --output``."""
FORMAT = 1  # number of the file's format
PERIOD = 0.05
"""Time between two poses of a trace [s]."""
_DAMAGE = (OSError, ValueError, LookupError, TypeError, AttributeError, EOFError, MemoryError)
_ZIPPED = (zipfile.BadZipFile, zlib.error, NotImplementedError)


@dataclass(frozen=True, eq=False, kw_only=True)
class Trace:
    """One episode of a policy on a scene. Frame of positions and points: world, x forward, z up."""

    policy: str = ""
    """Name of the policy, as in tables."""
    scene: str = ""
    """Name of the scene, as in tables."""
    episode: int = 0
    """Index of the episode within its evaluation, from 0."""
    seed: int = 0
    outcome: str = Outcome.REACHED
    conditions: str = ""
    """Hash of the scene's conditions."""
    digest: str = ""
    """SHA-256 of the episode's actions and poses; empty if it is unknown."""
    robot: RobotGeometry
    ground: FloatArray
    """Points of the profile, (V, 2) [m]; the ground is level before and past them."""
    time: FloatArray
    """(T,) [s], from the start of the episode to its end."""
    position: FloatArray
    """Chassis centre (x, z), (T, 2) [m]."""
    pitch: FloatArray
    """Nose up positive, (T,) [rad]."""
    front: FloatArray
    """Angle of the front flippers to the chassis, above it positive, the mean of both sides, (T,)
    [rad]."""
    rear: FloatArray
    """Angle of the rear flippers likewise, (T,) [rad]."""
    decided: FloatArray
    """Times of the decisions, (D,) [s]."""
    actions: FloatArray
    """Turns of the front and the rear flippers, each -1, 0 or 1, or means of both sides, (D, 2)."""
    heights: FloatArray
    """Perceived mean heights of the N bins ahead and behind, relative to the chassis centre, (D, N)
    [m]; NaN: the bin was never seen."""
    bin_width: float
    """Width of a bin [m]."""
    risk: FloatArray = field(default_factory=lambda: np.empty(0))
    """Risk at each decision, (D,); empty for a policy that tells none."""
    flippers: FloatArray = field(default_factory=lambda: np.empty(0))
    """Angles of four flippers, front left, front right, rear left and rear right, (T, 4) [rad];
    empty for pairs."""
    maps: tuple[FloatArray, ...] = ()
    """Points of the map at each decision, D arrays (P, 2) [m]; empty unless the sensor maps."""

    def __post_init__(self) -> None:
        """Give the arrays the precision of a file, so that what is drawn of them is equal."""
        for name in (*_ARRAYS, _FLIPPERS):
            object.__setattr__(self, name, _single(getattr(self, name)))
        object.__setattr__(self, "maps", tuple(map(_single, self.maps)))

    @classmethod
    def of(cls, transitions: Sequence[Transition], profile: Profile, **more: Any) -> Trace:
        """Return the trace of an episode; ``more``: further fields, by name."""
        # Heights are those of all decisions, or of none.
        states = list(instants(transitions, PERIOD))
        known = [t.perception for t in transitions if t.perception is not None]
        whole = len(known) == len(transitions)
        heights = np.array(list(map(_heights, known))) if whole else np.empty((len(transitions), 0))
        poses: dict[str, Any] = {n: np.array([getattr(s, n) for s in states]) for n in _POSE}
        return cls(
            **poses,
            flippers=np.array([s.flippers for s in states]),
            outcome=str(transitions[-1].outcome or ""),
            robot=transitions[0].robot,
            ground=profile.points,
            decided=np.array([t.before.time for t in transitions]),
            actions=np.array([means(t.action) for t in transitions], np.float64),
            heights=heights,
            bin_width=known[0].layout.bin_width if known else 0.0,
            maps=tuple(
                map_points(p, t.before.position)
                for p, t in zip(mapped(transitions), transitions, strict=False)
            ),
            **more,
        )

    @property
    def profile(self) -> Profile:
        """The ground."""
        return Profile(self.ground)

    def state(self, index: int) -> RobotState:
        """Return the pose at an index into ``time``, with velocities of zero."""
        pose = {name: getattr(self, name)[index] for name in _POSE}
        if self.flippers.size:
            pose["flippers"] = tuple(self.flippers[index].tolist())
        return RobotState(**pose, velocity=np.zeros(2), pitch_rate=0.0)

    def latest(self, time: float) -> int:
        """Return the index of the last decision at or before a time [s]."""
        return max(0, int(np.searchsorted(self.decided, time + 1e-6, "right")) - 1)


_POSE = ("position", "pitch", "front", "rear", "time")
_ARRAYS = ("ground", *_POSE, "decided", "actions", "heights", "risk")
_FLIPPERS = "flippers"  # an array that files of pairs, and those of before, lack
_WORDS = ("policy", "scene", "episode", "seed", "outcome", "conditions", "digest", "bin_width")
_GEOMETRY = tuple(RobotGeometry.model_fields)


def _single(array: FloatArray) -> FloatArray:
    return np.asarray(array, np.float32).astype(np.float64)


def instants(transitions: Sequence[Transition], period: float) -> Iterator[RobotState]:
    """Yield the robot's state at the start, every ``period`` [s], and at the end.

    Velocities are taken from the start of the decision, since poses have none. A decision without
    poses gives its start alone.
    """
    due = transitions[0].before.time
    for t in transitions:
        # Poses between decisions exist only where the physics was sampled.
        if not len(t.path):
            yield t.before
            due = t.after.time
        for index, (x, z, pitch) in enumerate(t.path[:-1].tolist()):
            time = t.before.time + index * t.sample_period
            # Half a sample of tolerance, so that rounding skips no pose that is due.
            if time < due - t.sample_period / 2:
                continue
            angles = by_joint(t.flippers[index].tolist())
            due += period
            place = np.array([x, z])
            yield replace(t.before, position=place, pitch=pitch, time=time, **angles)
    yield transitions[-1].after


def mapped(transitions: Sequence[Transition]) -> list[Perception]:
    """Return what was perceived at each decision; nothing unless the sensor maps the ground."""
    seen = [t.perception for t in transitions]
    perceived = [p for p in seen if p is not None and p.seen is not None]
    return perceived if len(perceived) == len(transitions) else []


def map_points(perception: Perception, position: FloatArray) -> FloatArray:
    """Return the points that were seen, without filled ones, in world, (P, 2) [m].

    ``position``: the true chassis centre (x, z) [m], so that only errors of the map itself show,
    and none of the odometry's drift, which policies do not feel.
    """
    points, filled = perception.points, perception.filled
    return position + (points if filled is None else points[~filled])


def _heights(p: Perception) -> FloatArray:
    heights = p.observation[: p.layout.bins].astype(np.float64)
    return heights if p.seen is None else np.where(p.seen, heights, np.nan)


def write(path: Path, traces: Sequence[Trace]) -> None:
    """Replace the content of ``path`` by the traces; equal traces give equal files."""
    arrays, headers = dict[str, Any](), list[dict[str, Any]]()
    for at, trace in enumerate(traces):
        for name in _ARRAYS:
            arrays[f"{at}.{name}"] = np.asarray(getattr(trace, name), np.float32)
        if trace.flippers.size:
            arrays[f"{at}.{_FLIPPERS}"] = np.asarray(trace.flippers, np.float32)
        # Maps differ in length: their points lie in one array, the counts in the header.
        arrays[f"{at}.maps"] = np.concatenate([*trace.maps, np.empty((0, 2))]).astype(np.float32)
        headers.append(
            {name: getattr(trace, name) for name in _WORDS}
            | {"robot": {name: getattr(trace.robot, name) for name in _GEOMETRY}}
            | {"map_points": list(map(len, trace.maps))}
        )
    # A .npz holds arrays alone: the header is one of bytes.
    document = json.dumps({"format": FORMAT, "traces": headers}).encode()
    buffer = io.BytesIO()
    np.savez_compressed(buffer, header=np.frombuffer(document, np.uint8), **arrays)
    write_bytes(path, buffer.getvalue())


def read(path: Path) -> list[Trace]:
    """Read a file of traces.

    Raises:
        RequestError: there is no such file, it is damaged, or another version wrote it.
    """
    try:
        with zipfile.ZipFile(path):  # else numpy takes it for a pickle, and advises to trust it
            pass
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            document = json.loads(file["header"].tobytes())
            if document["format"] != FORMAT:
                raise RequestError(f"{path}: {other_format(document['format'], FORMAT)}")
            return [_trace(file, at, header) for at, header in enumerate(document["traces"])]
    except FileNotFoundError as error:
        raise RequestError(f"{path}: there is no such file") from error
    except (*_DAMAGE, *_ZIPPED) as error:
        raise RequestError(f"{path}: it is damaged, or no file of traces: {error}") from error


def _trace(file: Mapping[str, FloatArray], at: int, header: Mapping[str, Any]) -> Trace:
    arrays: dict[str, Any] = {name: file[f"{at}.{name}"] for name in _ARRAYS}
    if (four := f"{at}.{_FLIPPERS}") in file:
        arrays[_FLIPPERS] = file[four]
    ends = np.cumsum(header["map_points"], dtype=np.int64)
    trace = Trace(
        **{name: header[name] for name in _WORDS},
        **arrays,
        robot=RobotGeometry(**header["robot"]),
        maps=tuple(np.split(file[f"{at}.maps"], ends)[:-1]),
    )
    # The file may be of any origin: check shapes, then numbers; heights may be NaN.
    count, decisions, bins = len(trace.time), len(trace.decided), arrays["heights"].shape[-1]
    shapes: dict[str, tuple[int, ...]] = {
        "ground": (len(trace.ground), 2),
        "position": (count, 2),
        "actions": (decisions, 2),
        "heights": (decisions, bins),
        "risk": (len(trace.risk),),
        **dict.fromkeys(("time", "pitch", "front", "rear"), (count,)),
        "decided": (decisions,),
        "flippers": (count, 4),
    }
    for name, array in arrays.items():
        if array.shape != shapes[name] or not (name == "heights" or np.isfinite(array).all()):
            raise ValueError(f"{name} of trace {at} is not finite, or has the shape {array.shape}")
    if not (count and decisions and len(trace.ground) and len(trace.risk) in (0, decisions)):
        raise ValueError(f"trace {at} has {count} poses and {decisions} decisions")
    return trace
