"""``hfc``: a machine of seven states, whose transitions are learnt from demonstrations."""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from flipperctl.api import (
    Controller,
    FloatArray,
    ObservationLayout,
    Perception,
    Policy,
    RecordedEpisode,
    Robot,
    RobotGeometry,
    Simulator,
    TrainingEpisodes,
    controller,
)

from .ground import Rows, ground, table
from .rules import towards

STATES = (
    "neutral",
    "ascending front",
    "up stairs",
    "ascending rear",
    "descending front",
    "down stairs",
    "descending rear",
)
NEXT = ((0, 1, 4), (1, 0, 2, 3), (2, 3), (3, 0), (4, 0, 5, 6), (5, 6), (6, 0))
"""States that may follow each one; it may stay first."""
TEMPLATES = (
    (0.0, 0.0),
    (0.4, 0.0),
    (-0.1, -0.1),
    (-0.1, -0.6),
    (-0.35, -0.7),
    (0.0, 0.05),
    (0.3, 0.4),
)
"""Front and rear angle of each state [rad]."""
PITCHES = np.array([0.0, 0.2, 0.4, 0.2, -0.2, -0.4, -0.2])
"""Pitch that is typical of each state, (7,) [rad]."""
_PITCH_WEIGHT = 0.3
"""Weight of the squared pitch error in the labels; the angles' errors have the weight 1 [-]."""
_ASCENDING_REAR = STATES.index("ascending rear")
_SCALE = np.array([1.0, 2.0, 5.0, 5.0, 5.0, 5.0])
_ROWS = sum(len(after) - 1 for after in NEXT)


def features(
    observation: NDArray[np.float32], layout: ObservationLayout, robot: RobotGeometry
) -> FloatArray:
    """Return 1, the pitch and the four heights of the ground, scaled, (6,) [-]."""
    pitch = float(observation[-1])
    return _SCALE * (1.0, pitch, *ground(observation, layout, robot))


def labels(angles: FloatArray, templates: FloatArray) -> list[int]:
    """Return the states before T decisions and after each, T + 1 numbers; neutral comes first.

    ``angles``: front, rear and pitch after each decision, (T, 3) [rad]. The states lie on the path
    through the permitted transitions with the least sum of squared differences from the
    ``templates`` (7, 2) and ``PITCHES`` (Viterbi).
    """
    # Misfit of every state after each decision
    costs = ((angles[:, None, :2] - templates) ** 2).sum(-1)  # (T, 7)
    costs += _PITCH_WEIGHT * (angles[:, 2:] - PITCHES) ** 2
    allowed = np.full((7, 7), math.inf)
    for before, after in enumerate(NEXT):
        allowed[before, after] = 0.0
    # The cheapest path to each state, and where it came from
    total, origins = np.full(7, math.inf), []
    total[0] = 0.0
    for cost in costs:
        paths = total[:, None] + allowed
        origins.append(paths.argmin(0))
        total = paths.min(0) + cost
    # Back along the cheapest path of all
    states = [int(total.argmin())]
    for origin in reversed(origins):
        states.append(int(origin[states[-1]]))
    return states[::-1]


@controller("hfc")
class Hfc(Controller):
    """Follow a machine of seven states, whose transitions were learnt from demonstrations.

    Azayev and Zimmermann (RA-L 2022). Each state has a template of angles. Each transition has a
    probability, linear softmax of pitch and perceived ground; the probabilities of the states are
    propagated, and the likeliest state acts. While the robot stagnates with its rear ascending, the
    front pair is raised and the rear one lowered. The paper's roll term has no effect without roll.
    """

    imitates: ClassVar[bool] = True
    weights: Rows = Field(
        (),
        description="weights of the transitions, 12 rows of 6; empty: those of the package, learnt "
        "from generalist on the ten families [-]",
    )
    templates: tuple[tuple[float, float], ...] = Field(
        TEMPLATES,
        min_length=7,
        max_length=7,
        description=f"front and rear angle of the states {', '.join(STATES)} [rad]",
    )
    escape_front: float = Field(
        0.3, ge=-1, le=1, description="raise of the front pair at full stagnation [rad]"
    )
    escape_rear: float = Field(
        0.5, ge=-1, le=1, description="lowering of the rear pair at full stagnation [rad]"
    )

    @model_validator(mode="after")
    def _weights_are_whole(self) -> Self:
        if self.weights and [len(row) for row in self.weights] != [_SCALE.size] * _ROWS:
            raise ValueError(f"weights needs {_ROWS} rows of {_SCALE.size} numbers")
        return self

    def build(self) -> Policy:
        """Return a policy that begins each episode in the neutral state."""
        return Machine(self)

    def targets(self, state: int, stagnation: float) -> tuple[float, float]:
        """Return the angles (front, rear) in a state; ``stagnation`` is 0 to 1 [rad]."""
        front, rear = self.templates[state]
        escape = stagnation if state == _ASCENDING_REAR else 0.0
        return front + self.escape_front * escape, rear - self.escape_rear * escape

    def learn(self, episodes: TrainingEpisodes) -> Self:
        """Return the machine with transitions fitted to the states of demonstrations."""
        # What was seen and what followed, apart for each state before
        inputs: list[list[FloatArray]] = [[] for _ in NEXT]
        choices: list[list[int]] = [[] for _ in NEXT]
        for episode in episodes.demonstrations():
            for before, after, seen in self._steps(episode, episodes.layout, episodes.robot):
                inputs[before].append(seen)
                choices[before].append(NEXT[before].index(after))
        rows = [
            row
            for after, seen, taken in zip(NEXT, inputs, choices, strict=True)
            for row in softmax_fit(np.array(seen), np.array(taken), len(after))
        ]
        return self.model_copy(update={"weights": table(rows, 2)})

    def _steps(
        self, episode: RecordedEpisode, layout: ObservationLayout, robot: Robot
    ) -> Iterator[tuple[int, int, FloatArray]]:
        """Yield the state before each decision, the state after it, and the features."""
        observations = episode.observations
        # The angles of all joints and the pitch are the last numbers; of four, the means count.
        last = observations[1:, -1 - len(layout.joints) :].astype(np.float64)
        ends = last[:, :-1].reshape(len(last), 2, -1).mean(2)
        states = labels(np.column_stack([ends, last[:, -1]]), np.array(self.templates))
        for t, (before, after) in enumerate(pairwise(states)):
            yield before, after, features(observations[t], layout, robot)


def softmax_fit(inputs: FloatArray, choices: NDArray[np.int64], count: int) -> FloatArray:
    """Return the weights (count - 1, F) of a linear softmax whose first class has zeros.

    ``inputs`` (M, F), ``choices`` (M,) from 0 to count - 1. They minimise the negative
    log-likelihood plus half the sum of their squares; without inputs they are zeros.
    """
    from scipy.optimize import minimize

    size = _SCALE.size
    # Without a demonstration, all permitted transitions are equally probable.
    if not len(inputs):
        return np.zeros((count - 1, size))
    taken = np.eye(count)[choices]  # (M, count)

    def loss(flat: FloatArray) -> tuple[float, FloatArray]:
        weights = flat.reshape(count - 1, size)
        chances = softmax(inputs @ weights.T)
        slope = (chances - taken)[:, 1:].T @ inputs + weights
        value = -np.log(np.maximum((chances * taken).sum(1), 1e-300)).sum()
        return float(value + (flat @ flat) / 2), slope.ravel()

    fit = minimize(loss, np.zeros((count - 1) * size), jac=True, method="L-BFGS-B")
    weights: FloatArray = fit.x.reshape(count - 1, size)
    return weights


def softmax(scores: FloatArray) -> FloatArray:
    """Return the probabilities of the first class, whose score is 0, and the others, (..., K)."""
    whole = np.concatenate([np.zeros((*scores.shape[:-1], 1)), scores], axis=-1)
    powers = np.exp(whole - whole.max(axis=-1, keepdims=True))
    chances: FloatArray = powers / powers.sum(axis=-1, keepdims=True)
    return chances


class Machine:
    """The states of one episode."""

    def __init__(self, settings: Hfc) -> None:
        self._settings = settings
        rows = np.array(settings.weights or SHIPPED)
        ends = np.cumsum([len(after) - 1 for after in NEXT])[:-1]
        self._weights = np.split(rows, ends)
        self.chances = np.eye(len(NEXT))[0]
        """Probability of each state, (7,)."""
        self._position: FloatArray | None = None

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode in the neutral state."""
        self.chances, self._position = np.eye(len(NEXT))[0], None

    def act(self, p: Perception) -> int:
        """Turn each pair one step towards the angles of the likeliest state."""
        seen, chances = features(p.observation, p.layout, p.robot), np.zeros(len(NEXT))
        # The chances of the states move along the permitted transitions.
        for before, after in enumerate(NEXT):
            chances[list(after)] += self.chances[before] * softmax(self._weights[before] @ seen)
        self.chances = chances
        angles = self._settings.targets(int(chances.argmax()), self._stagnation(p))
        return towards(p, *map(p.robot.clip, angles))

    def _stagnation(self, p: Perception) -> float:
        """Return s = clip(1 - v / v_cmd, 0, 1), by the odometry since the last decision.

        It is 0 at the first decision, and with a sensor that has no odometry.
        """
        before, self._position = self._position, p.position
        if before is None or p.position is None:
            return 0.0
        robot = p.robot if isinstance(p.robot, Robot) else Robot()
        moved = math.hypot(*(p.position - before))
        return min(1.0, max(0.0, 1 - moved / (robot.track_speed * robot.decision_period)))


SHIPPED: Rows = (
    (-1.23, -5.23, 2.31, 3.02, 0.51, -0.01),
    (-4.5, 1.56, -1.22, -0.68, -0.05, -2.24),
    (-4.05, 1.13, -3.39, 0.92, 0.15, -1.68),
    (-3.88, 3.04, -0.93, -1.16, -1.64, -0.36),
    (-3.93, -0.81, -2.55, 0.84, -0.24, -3.97),
    (-2.9, -3.63, -0.32, -0.35, -0.8, 0.32),
    (0.3, 1.3, -0.62, 0.08, 1.33, 1.94),
    (1.88, -0.45, -0.25, 1.26, 2.08, 1.72),
    (0.95, -2.49, 0.75, -0.51, 1.05, 3.46),
    (-2.08, -0.29, 1.21, 0.74, 2.21, 0.94),
    (2.44, -4.69, 3.95, 1.01, -0.49, -1.06),
    (-4.77, -2.92, -2.11, -0.1, 0.05, 1.77),
)
