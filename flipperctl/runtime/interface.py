"""A file of ``flipperctl export onnx``: its checksum, and the inputs and outputs that it states.

In: the bytes of a file. Out: a session of onnxruntime and an ``Interface`` from the metadata, both
checked. The SHA-256 is verified before any other code parses the file. It is computed over the
whole file with its own 64 hexadecimal digits set to 0, so that it covers graph and metadata.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.core import observation as layout
from flipperctl.core.lidar.ground import MapQuality
from flipperctl.core.reading import read_whole
from flipperctl.core.risk import LAGS, SCALE, EscapeRule, RiskSign
from flipperctl.core.targets import JOINTS, ActionKind, Flippers, TargetRule
from flipperctl.errors import PolicyError, missing_extra, other_format
from flipperctl.runtime.devices import SECTION, Devices, devices_of

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

FORMAT_VERSION = 3
"""Format of the metadata under ``flipperctl.*``."""
PREFIX = "flipperctl."
CHECKSUM = f"{PREFIX}sha256"
PLACEHOLDER = "0" * 64
"""Value of the checksum entry while the checksum is computed."""
INPUT, RISK, RECURRENCE = "observation", "risk", "risk_recurrence"
OUTPUTS: dict[ActionKind, str] = {"turns": "q_values", "rates": "rates"}
"""Names of the network's input and outputs."""
LARGEST_ANGLE = math.pi
"""Largest angle of an observation, both ways [rad]; a larger one is probably in degrees."""
LARGEST_HEIGHT = 5.0
"""Largest height of an observation, plus half the length of the perceived ground [m].

No passable ground is as high or as deep. The limit detects heights in wrong units: level ground is
about -10 in centimetres and -100 in millimetres.
"""
_FORMAT = f"{PREFIX}format_version"


@dataclass(frozen=True)
class Quantity:
    """One number of an observation."""

    name: str
    unit: str
    frame: str
    """Frame of reference. L: level, at the chassis centre; R: fixed to the chassis."""
    meaning: str


@dataclass(frozen=True)
class PluginFile:
    """A plugin of the training that was loaded from a file, not from an installed package."""

    kind: str
    name: str
    file: str
    """Name of the file, without its folder."""


@dataclass(frozen=True, eq=False)
class Interface:
    """The inputs and outputs of an exported policy, read from its metadata."""

    observation: tuple[Quantity, ...]
    """The numbers of one observation, in their order."""
    bins: int
    """N, the number of bins of the ground."""
    bin_width: float
    """Width of a bin [m]."""
    highest: bool
    """Whether N heights of highest points follow the N mean heights."""
    frames: int
    """Number of consecutive observations that form one input of the network, oldest first."""
    actions: NDArray[np.float64]
    """Turn of each joint by each action, (3^J, J), or by a rate of 1 of each joint, (J, J), in
    frame R [rad]."""
    targets: TargetRule
    """How an action turns the flippers."""
    decision_period: float
    """Time between two actions [s]."""
    robot: Mapping[str, float]
    """Geometry, masses and speeds of the robot that the policy was trained for, in SI units."""
    terrain: str
    """Name of the terrain plugin of the training."""
    terrain_config: Mapping[str, Any]
    """``name`` and all fields of that plugin."""
    seed: int
    """Seed of the training."""
    package_version: str
    """Version of flipperctl that exported the policy."""
    plugins: tuple[PluginFile, ...] = ()
    """Plugins of the training that were not installed; a robot needs none of them."""
    risk: RiskSign | None = None
    """When the policy's risk is a warning; None for a policy that tells none."""
    escape: EscapeRule | None = None
    """How actions are drawn on a warning; None for a policy that never draws them."""
    map_quality: MapQuality | None = None
    """Settings of the map in the training; None for a policy that was trained without a LiDAR."""
    devices: Devices | None = None
    """The robot's devices; None if they were not exported with the policy."""
    sides: bool = False
    """Whether the heights of both sides follow, and the roll stands before the angles."""
    flippers: Flippers = "pairs"
    """Whether the left and the right flippers turn together, or each of the four alone."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J joints, in the order of angles and turns."""
        return JOINTS[self.flippers]

    @property
    def kind(self) -> ActionKind:
        """Whether the outputs are Q-values of actions, or rates from -1 to 1."""
        return "rates" if len(self.actions) == len(self.joints) else "turns"

    @property
    def output(self) -> str:
        """Name of the output with a number for each row of ``actions``."""
        return OUTPUTS[self.kind]

    @property
    def size(self) -> int:
        """Length of one observation."""
        return len(self.observation)

    @property
    def heights(self) -> int:
        """Number of terrain heights in an observation: N or 2 N, with sides three times that."""
        return layout.heights(self.bins, self.highest, self.sides)

    @property
    def limits(self) -> NDArray[np.float64]:
        """Largest plausible magnitudes of the numbers of one observation, (n,) [m, rad]."""
        largest = LARGEST_HEIGHT + layout.reach(self.bins, self.bin_width)
        angles = [LARGEST_ANGLE] * (self.size - self.heights)
        return np.array([largest] * self.heights + angles)

    @property
    def inputs(self) -> int:
        """Length of one input of the network: frames · ``size``."""
        return self.frames * self.size


def add_checksum(data: bytes) -> bytes:
    """Return a model's bytes with their checksum in place of the one ``PLACEHOLDER``."""
    start = _find_entry(data, CHECKSUM, len(PLACEHOLDER))
    if start is None or data[start : start + len(PLACEHOLDER)] != PLACEHOLDER.encode():
        raise ValueError(f"the model's metadata must hold {CHECKSUM} once, as the placeholder")
    return _replace_at(data, start, hashlib.sha256(data).hexdigest())


def verify(data: bytes, where: str) -> bytes:
    """Return the bytes of a file; PolicyError unless they are as this version exported them."""
    start = _find_entry(data, CHECKSUM, len(PLACEHOLDER))
    if start is not None:
        # The checksum covers all bytes but its own.
        stated = data[start : start + len(PLACEHOLDER)]
        expected = hashlib.sha256(_replace_at(data, start, PLACEHOLDER)).hexdigest()
        if stated != expected.encode():
            raise PolicyError(
                f"{where} is damaged, or was changed since its export: "
                "its SHA-256 does not match its contents"
            )
        return data

    # Without one: another file, another format, or damage
    version = _find_entry(data, _FORMAT, 1)
    if version is None:
        raise PolicyError(
            f"{where} is damaged, or not a file of flipperctl export onnx: it holds no {_FORMAT}"
        )
    number = data[version : version + 1].decode(errors="replace")
    if number != str(FORMAT_VERSION):
        raise PolicyError(f"{where} may be damaged: {other_format(number, FORMAT_VERSION)}")
    raise PolicyError(f"{where} is damaged: its SHA-256 cannot be found")


def _find_entry(data: bytes, key: str, length: int) -> int | None:
    """Return the offset of a metadata entry's value; None unless one of that length exists.

    An entry is a protobuf message of two strings: tag 1, length, key, tag 2, length, value. An
    entry that occurs twice counts as missing.
    """
    marker = b"\x0a%c%b\x12%c" % (len(key), key.encode(), length)
    at = data.find(marker)
    start = at + len(marker)
    if at < 0 or data.find(marker, start) >= 0 or start + length > len(data):
        return None
    return start


def _replace_at(data: bytes, start: int, value: str) -> bytes:
    return data[:start] + value.encode() + data[start + len(value) :]


def open_session(path: Path) -> InferenceSession:
    """Open a session with one thread; a network of this size is slower with two."""
    try:
        import onnxruntime
    except ImportError as error:
        raise missing_extra("an exported policy", "onnxruntime") from error
    try:
        # The file is verified before anything parses it.
        data = read_whole(path, lambda data: verify(data, str(path)), PolicyError)
    except FileNotFoundError as error:
        raise PolicyError(f"{path}: there is no such policy file") from error
    except (OSError, ValueError) as error:  # ValueError: the name is not valid
        reason = getattr(error, "strerror", None) or error
        raise PolicyError(f"{path} cannot be read: {reason}") from error

    # Errors are raised, and nothing is printed.
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 4  # errors are raised instead
    try:
        return onnxruntime.InferenceSession(
            data,
            options,
            providers=["CPUExecutionProvider"],
            enable_fallback=0,  # the fallback would only retry, and print to stdout
        )
    except Exception as error:  # onnxruntime's errors share no base class
        raise PolicyError(
            f"{path} is damaged or not an ONNX model that onnxruntime can run: {reason_of(error)}"
        ) from error


def reason_of(error: Exception) -> str:
    """Return what onnxruntime says, in printable words on one line."""
    words = " ".join(str(error).split()).rpartition(" : ")[2]
    return "".join(sign if sign.isprintable() else "?" for sign in words[:300])


def interface_of(session: InferenceSession, where: str) -> Interface:
    """Return the interface that a model states; PolicyError if its input or outputs are others."""
    try:
        tensors = [(t.name, t.type, t.shape) for t in session.get_inputs() + session.get_outputs()]
        metadata = session.get_modelmeta().custom_metadata_map
    except (UnicodeDecodeError, RuntimeError) as error:
        raise PolicyError(f"{where} is damaged: its names or metadata are not text") from error
    interface = read_interface(metadata, where)
    sizes = {INPUT: interface.inputs, interface.output: len(interface.actions)}
    if interface.risk is not None:
        sizes |= {RISK: 1, RECURRENCE: len(LAGS)}

    # Names, types and sizes must be as the metadata state.
    fits = {name for name, *_ in tensors} == sizes.keys() and all(
        kind == "tensor(float)" and len(shape) == 2 and shape[1] == sizes[name]
        for name, kind, shape in tensors
    )
    if not fits:
        shown = ", ".join(f"{name} {kind} {shape}" for name, kind, shape in tensors)
        *most, last = [f"{name} tensor(float) [batch, {size}]" for name, size in sizes.items()]
        raise PolicyError(
            f"{where}: the model has {shown}; {', '.join(most)} and {last} is allowed"
        )
    return interface


@dataclass(frozen=True)
class _Rule:
    """What a value of the metadata may be."""

    allowed: str
    """In words, for errors."""
    fits: Callable[[Any], bool]


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= sys.float_info.max  # false for NaN; integers are unbounded


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


_WHOLE, _NUMBER = _Rule("a whole number", _is_whole), _Rule("a number", _is_number)
_COUNT = _Rule("a whole number above 0", lambda v: _is_whole(v) and v > 0)
_POSITIVE = _Rule("a number above 0", lambda v: _is_number(v) and v > 0)
_SHARE = _Rule("a number above 0 and at most 1", lambda v: _is_number(v) and 0 < v <= 1)
_FLAG = _Rule("true or false", lambda v: isinstance(v, bool))
_TEXT = _Rule("text", lambda v: isinstance(v, str))
_BY_TYPE = {"int": _COUNT, "float": _POSITIVE, "bool": _FLAG, "str": _TEXT}
"""Annotation of a dataclass's field → its rule."""


def _exactly(value: Any) -> _Rule:
    return _Rule(json.dumps(value), lambda v: v == value)


def _one_of(*values: Any) -> _Rule:
    return _Rule(" or ".join(map(json.dumps, values)), lambda v: v in values)


def _list(item: _Rule, *lengths: int) -> _Rule:
    """Return the rule of a list of one of these lengths, or of any."""
    count = f" of {' or '.join(map(str, lengths))}" if lengths else ""
    return _Rule(
        f"a list{count}, each {item.allowed}",
        lambda v: (
            isinstance(v, list) and (not lengths or len(v) in lengths) and all(map(item.fits, v))
        ),
    )


def _mapping(kind: type[Any], **others: _Rule) -> _Rule:
    """Return the rule of a mapping of a dataclass's fields; ``others`` prevail or are added."""
    rules = {field.name: _BY_TYPE[str(field.type)] for field in fields(kind)} | others
    return _Rule(
        "a mapping with " + ", ".join(f"{name}: {rule.allowed}" for name, rule in rules.items()),
        lambda v: (
            isinstance(v, dict) and all(rule.fits(v.get(name)) for name, rule in rules.items())
        ),
    )


def _built(kind: type[Any], value: Mapping[str, Any]) -> Any:
    """Return a dataclass of a mapping that may hold more than its fields."""
    return kind(**{field.name: value[field.name] for field in fields(kind)})


def read_interface(metadata: Mapping[str, str], where: str) -> Interface:
    """Return the interface that valid metadata of a model describe; otherwise a PolicyError.

    ``where``: name of the file, for the errors.
    """
    version = metadata.get(_FORMAT)
    if version != str(FORMAT_VERSION):
        raise PolicyError(f"{where}: {other_format(version, FORMAT_VERSION)}")

    def entry(name: str, rule: _Rule, absent: str = "") -> Any:
        """Return an entry's value; ``absent`` is the text of a missing one."""
        text = metadata.get(f"{PREFIX}{name}", absent)
        try:
            value = json.loads(text)
        except (ValueError, RecursionError):
            value = None
        if value is None or not rule.fits(value):
            raise PolicyError(
                f"{where}: {PREFIX}{name} is {text[:60]!r} in its metadata; {rule.allowed} is "
                "allowed"
            )
        return value

    def optional(name: str, kind: type[Any], **others: _Rule) -> Any:
        """Return an entry as a dataclass; None if the file does not have it."""
        if f"{PREFIX}{name}" not in metadata:
            return None
        return _built(kind, entry(name, _mapping(kind, **others)))

    # The observation, and what the outputs mean
    bins, highest = entry("bins", _COUNT), entry("highest", _FLAG)
    sides = entry("sides", _FLAG, "false")
    known: dict[tuple[str, ...], Flippers] = {names: word for word, names in JOINTS.items()}
    flippers = known[tuple(entry("joints", _one_of(*map(list, known))))]
    joints = len(JOINTS[flippers])
    size = layout.heights(bins, highest, sides) + len(layout.angles(sides, joints))
    observation = entry("observation", _list(_mapping(Quantity), size))
    rows = _list(_list(_NUMBER, joints), 3**joints, joints)  # or of rates
    actions = np.array(entry("actions", rows), dtype=np.float64)
    actions.setflags(write=False)
    numbers = _Rule(
        "a mapping of names to numbers",
        lambda v: isinstance(v, dict) and all(map(_is_number, v.values())),
    )
    terrain = metadata.get(f"{PREFIX}terrain", "")
    named = _Rule(
        f"a mapping with the name {terrain!r} and the terrain's fields",
        lambda v: isinstance(v, dict) and v.get("name") == terrain,
    )

    # What only some policies have: a risk, and actions that are drawn
    lags, scale = _exactly(list(LAGS)), _exactly(SCALE)
    risk = optional("risk", RiskSign, threshold=_SHARE, lags=lags, scale=scale)
    escape = optional("escape", EscapeRule)
    if escape is not None and risk is None:
        raise PolicyError(f"{where}: {PREFIX}escape is allowed beside {PREFIX}risk alone")
    return Interface(
        observation=tuple(_built(Quantity, each) for each in observation),
        bins=bins,
        bin_width=entry("bin_width", _POSITIVE),
        highest=highest,
        frames=entry("frames", _COUNT),
        actions=actions,
        targets=_built(TargetRule, entry("targets", _mapping(TargetRule))),
        decision_period=entry("decision_period", _POSITIVE),
        robot=MappingProxyType(entry("robot", numbers)),
        terrain=terrain,
        terrain_config=MappingProxyType(entry("terrain_config", named)),
        seed=entry("seed", _WHOLE),
        package_version=metadata.get(f"{PREFIX}package_version", ""),
        plugins=tuple(
            _built(PluginFile, each) for each in entry("plugins", _list(_mapping(PluginFile)), "[]")
        ),
        risk=risk,
        escape=escape,
        map_quality=optional("map", MapQuality),
        devices=_devices(metadata, where),
        sides=sides,
        flippers=flippers,
    )


def _devices(metadata: Mapping[str, str], where: str) -> Devices | None:
    text = metadata.get(f"{PREFIX}{SECTION}")
    try:
        return None if text is None else devices_of(json.loads(text), f"{where}: {SECTION}")
    except ValueError as error:
        raise PolicyError(f"{where}: {PREFIX}{SECTION} is no JSON in its metadata") from error
