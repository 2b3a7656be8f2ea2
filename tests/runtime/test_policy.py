"""The policy as the robot runs it: observations, decisions, targets, risk and errors."""

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flipperctl.core.observation import to_level
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import FlipperctlError, MissingExtraError, NonFiniteError, PolicyError
from flipperctl.runtime import OnnxPolicy, TargetRule
from tests.runtime.linear import METADATA, PAPER, RISK, SIDES, SIZE, STEP, write


@pytest.fixture
def policy(tmp_path: Path) -> OnnxPolicy:
    return OnnxPolicy(write(tmp_path / "p.onnx"))


def observation(highest: int) -> np.ndarray:
    """Return an observation of zeros but one height."""
    return np.eye(SIZE)[highest] * 0.3


def test_the_action_of_the_largest_q_value_is_taken(policy: OnnxPolicy) -> None:
    assert [policy.act(observation(a)) for a in (4, 0, 8)] == [4, 0, 8]
    assert policy.act(list(observation(7))) == 7
    assert policy.act(observation(2).astype(np.float32)) == 2
    assert policy.act(-1.0 - observation(3)[::-1]) == 0  # all equal: the first
    first = policy.q_values(observation(4))
    policy.act(observation(6))
    assert first.tolist() == pytest.approx([0, 0, 0, 0, 0.3, 0, 0, 0, 0])
    many = policy.q_values(np.stack([observation(a) for a in (1, 5, 6)]))
    assert many.argmax(1).tolist() == [1, 5, 6]
    assert policy.q_values(np.zeros((0, SIZE))).shape == (0, 9)
    largest = np.array([6.125] * 30 + [math.pi] * 3)
    assert policy.interface.limits == pytest.approx(largest)
    for sign in (-1, 1):
        policy.act(sign * largest)


@pytest.mark.parametrize(
    ("at", "value", "error", "text"),
    [
        (
            SIZE - 2,
            math.nan,
            NonFiniteError,
            rf"{SIZE - 2}\] \(theta_f2\) is nan; finite numbers are allowed",
        ),
        (
            SIZE - 1,
            20.0,
            PolicyError,
            rf"{SIZE - 1}\] \(theta_R\) is 20 rad; ±π is allowed: angles are in rad",
        ),
        # 5 m and half of 15 bins of 0.15 m
        (18, -100.0, PolicyError, r"18\] \(top_4\) is -100 m; ±6\.125 m is allowed"),
        (3, -100.0, PolicyError, r"3\] \(h_4\) is -100 m; ±6\.125 m is allowed: .* in metres"),
    ],
)
def test_a_number_that_cannot_be_is_refused(
    policy: OnnxPolicy, at: int, value: float, error: type[FlipperctlError], text: str
) -> None:
    wrong = observation(4)
    wrong[at] = value
    with pytest.raises(error, match=rf"observation\[{text}"):
        policy.act(wrong)
    with pytest.raises(error, match=rf"observation\[1, {text}"):
        policy.q_values([observation(4), wrong])
    assert policy.act(observation(5)) == 5  # the next decision is right again


def test_what_is_no_observation_is_refused(policy: OnnxPolicy) -> None:
    for shape in ((SIZE - 1,), (1, SIZE), ()):
        with pytest.raises(
            PolicyError, match=rf"shape .*\({SIZE},\) is allowed: 30 terrain heights"
        ):
            policy.act(np.zeros(shape))
    for shape in ((SIZE - 1,), (2, SIZE - 1), (2, 1, SIZE)):
        with pytest.raises(PolicyError, match=rf"\({SIZE},\) or \(B, {SIZE}\) is allowed"):
            policy.q_values(np.zeros(shape))
    for odd in (["0.1"] * SIZE, np.full(SIZE, 1j), [10**400] * SIZE):
        for call in (policy.act, policy.q_values):
            with pytest.raises(PolicyError, match="the observation is not numbers"):
                call(odd)
    with pytest.raises(PolicyError, match=rf"no observation \(None\); {SIZE} numbers are needed"):
        policy.act(None)


def test_a_q_value_that_is_not_finite_is_no_action(tmp_path: Path) -> None:
    policy = OnnxPolicy(write(tmp_path / "p.onnx", scale=3e38))
    for call in (policy.act, policy.q_values):
        with pytest.raises(NonFiniteError, match="Q-value of action 4 is inf"):
            call(observation(4) * 4)
    with pytest.raises(NonFiniteError, match="Q-value of action 0 is nan"):
        OnnxPolicy(write(tmp_path / "q.onnx", scale=math.nan))


def test_a_policy_of_several_frames_keeps_the_observations_before(tmp_path: Path) -> None:
    # 9 heights and angles of 3 frames; its Q-values are the first 9 numbers: the oldest frame
    entries = METADATA["observation"][:6] + METADATA["observation"][-3:]
    path = write(tmp_path / "p.onnx", size=27, bins=3, observation=entries, frames=3)
    policy = OnnxPolicy(path)
    assert (policy.interface.size, policy.interface.frames, policy.interface.inputs) == (9, 3, 27)

    def act(*highest: int) -> list[int]:
        return [policy.act(np.eye(9)[a]) for a in highest]

    assert act(4, 5, 6, 7) == [4, 4, 4, 5]  # the first also fills the frames before it
    assert act(8) == [6]
    policy.reset()
    assert act(2, 1, 0, 3) == [2, 2, 2, 1]
    with pytest.raises(NonFiniteError, match=r"observation\[7\] \(theta_f2\) is nan"):
        policy.act(np.where(np.arange(9) == 7, np.nan, 0.0))
    assert act(8) == [0]  # the refused observation is not kept
    with pytest.raises(PolicyError, match=r"\(27,\) or \(B, 27\) is allowed: 6 .* of each frame"):
        policy.q_values(np.zeros(9))
    assert policy.q_values(np.arange(27.0) / 9).tolist() == pytest.approx(np.arange(9) / 9)
    with pytest.raises(PolicyError, match=r"observation\[16\] \(theta_f2\) is 4 rad"):
        policy.q_values(np.where(np.arange(27) == 16, 4.0, 0.0))


def test_it_runs_on_one_thread(policy: OnnxPolicy) -> None:
    options = policy._session.get_session_options()
    assert (options.intra_op_num_threads, options.inter_op_num_threads) == (1, 1)


def test_a_file_that_is_no_policy_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="there is no such policy file"):
        OnnxPolicy(tmp_path / "none.onnx")
    with pytest.raises(PolicyError, match="cannot be read: Is a directory"):
        OnnxPolicy(tmp_path)
    whole = write(tmp_path / "p.onnx").read_bytes()
    for data in (b"", b"a letter", whole[:200]):
        (tmp_path / "bad.onnx").write_bytes(data)
        with pytest.raises(PolicyError, match=r"bad\.onnx is damaged, or not a file of flipperctl"):
            OnnxPolicy(tmp_path / "bad.onnx")


def test_a_missing_onnxruntime_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(MissingExtraError, match="needs onnxruntime: pip install onnxruntime"):
        OnnxPolicy(tmp_path / "p.onnx")


def test_a_robot_needs_only_numpy_and_onnxruntime(tmp_path: Path) -> None:
    path = write(tmp_path / "p.onnx")
    absent = ["torch", "pymunk", "pydantic", "gymnasium", "hydra", "omegaconf", "matplotlib"]
    absent += ["typer", "rich", "safetensors", "onnx", "numba", "scipy"]
    script = (
        f"import sys; sys.modules.update(dict.fromkeys({absent!r}))\n"
        "from flipperctl.runtime import OnnxPolicy\n"
        f"policy = OnnxPolicy({str(path)!r})\n"
        f"observation = [0.0] * {SIZE}; observation[6] = 0.2\n"
        "print(policy.act(observation), policy.q_values(observation)[6])\n"
        f"assert not any(sys.modules[name] for name in {absent!r})"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["6", "0.2"]


# From what a robot measures to the observation: as in the environment, bit for bit


GROUND = np.column_stack([np.linspace(-2.0, 2.0, 81), np.full(81, -0.1)])
ANGLES = {"front": 0.3, "rear": -0.2, "pitch": 0.1}


@pytest.mark.parametrize("highest", [True, False])
def test_it_is_the_environment_s_own(highest: bool, tmp_path: Path) -> None:
    policy = OnnxPolicy(write(tmp_path / "p.onnx", **({} if highest else PAPER)))
    env = FlipperEnv("stair", perception={"dropout": 0.2, "highest": highest})
    env.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(8):
        p = env.perception
        points = np.concatenate([p.points, [[-1.2, 9.0], [3.0, 9.0]]])  # two beyond the bins
        found = policy.observation(points, front=p.front, rear=p.rear, pitch=p.pitch)
        assert found.dtype == np.float32
        assert found.tolist() == p.observation.tolist()
        env.step(int(rng.integers(9)))


def test_points_of_the_chassis_frame_are_levelled(policy: OnnxPolicy) -> None:
    fixed = to_level(GROUND, -ANGLES["pitch"])
    found = policy.observation(fixed, **ANGLES, frame="R")
    assert found == pytest.approx(np.array([-0.1] * 30 + [0.3, -0.2, 0.1]), abs=1e-6)
    assert policy.act(found) == 0


@pytest.mark.parametrize(
    ("points", "frame", "error", "text"),
    [
        ([[0.0, 0.0, 0.0]], "L", PolicyError, r"shape \(1, 3\); \(P, 2\) is allowed"),
        (np.empty((0, 2)), "L", PolicyError, r"none of the 0 points lies within ±1\.125 m"),
        ([[0.0, -0.1], [0.1, math.nan]], "L", NonFiniteError, r"point 1 is \(0\.1, nan\)"),
        (["far"], "L", PolicyError, "the points are not numbers"),
        ([[0, "1"]], "L", PolicyError, "the points are not numbers"),
        (GROUND, "W", PolicyError, "no frame 'W'; 'L'"),
    ],
)
def test_points_that_are_none_are_refused(
    policy: OnnxPolicy, points: Any, frame: Any, error: type[FlipperctlError], text: str
) -> None:
    with pytest.raises(error, match=text) as caught:
        policy.observation(points, **ANGLES, frame=frame)
    assert str(caught.value).startswith(str(policy.path))


# How an action turns the flippers


RULE = TargetRule(window=0.25, limit=1.0)
STATED = {"meaning": "x", "window": 0.25, "limit": 1.0}


@pytest.mark.parametrize(
    ("last", "measured", "turn", "expected"),
    [
        (0.5, 0.5, 0.25, 0.75),
        (0.5, 0.47, 0.25, 0.75),  # it follows: its target keeps the grid of angles
        (0.5, 0.25, 0.25, 0.75),  # as far behind as is allowed
        (0.5, 0.125, 0.25, 0.625),  # blocked: 0.125 + 0.25 is turned by 0.25
        (0.625, 0.125, 0.0, 0.375),  # a command to hold keeps one window of it
        (0.625, 0.125, -0.25, 0.125),  # the opposite command stops pushing at once
        (-0.5, 0.0, -0.25, -0.5),
        (0.9, 0.95, 0.25, 1.0),  # the limit
        (-0.9, -1.3, 0.0, -1.0),  # a flipper that was pushed past the limit
    ],
)
def test_a_target_stays_near_the_measured_angle(
    last: float, measured: float, turn: float, expected: float
) -> None:
    found = RULE.next_targets((last, -last), (measured, -measured), (turn, -turn))
    assert found == pytest.approx((expected, -expected))


def test_the_robot_turns_its_flippers_by_the_rule_of_its_policy(tmp_path: Path) -> None:
    policy = OnnxPolicy(write(tmp_path / "p.onnx", targets=STATED))
    assert policy.interface.targets == RULE
    # action 2: front down, rear up, each by 15°
    found = policy.next_targets([0.5, 0.0], [0.125, 0.0], 2)
    assert found.tolist() == pytest.approx([0.375 - STEP, STEP])


@pytest.mark.parametrize(
    ("targets", "angles", "action", "error", "text"),
    [
        ([0.0], [0.0, 0.0], 4, PolicyError, r"targets have shape \(1,\); \(2,\) is allowed"),
        *(([n, 0], [0, 0], 4, PolicyError, "targets are not numbers") for n in ("1", 1j, 10**400)),
        ([0.0, 0.0], [math.nan, 0.0], 4, NonFiniteError, "angles are .*nan"),
        ([0.0, 0.0], [45.0, 0.0], 4, PolicyError, r"angles are \[45\.  0\.\] rad; ±π is allowed"),
        ([0.0, 0.0], [0.0, 0.0], 9, PolicyError, "no action 9; a whole number from 0 to 8 is"),
        ([0.0, 0.0], [0.0, 0.0], 1.5, PolicyError, "no action 1.5; a whole number"),
    ],
)
def test_wrong_arguments_are_refused(
    targets: list, angles: list, action: int, error: type, text: str, tmp_path: Path
) -> None:
    policy = OnnxPolicy(write(tmp_path / "p.onnx", targets=STATED))
    with pytest.raises(error, match=text):
        policy.next_targets(targets, angles, action)


# The risk


def seen(height: float) -> np.ndarray:
    """An observation with this first height."""
    return np.array([height] + [0.0] * (SIZE - 1))


def sigmoid(score: float) -> float:
    return 1 / (1 + math.exp(-score))


@pytest.fixture
def risky(tmp_path: Path) -> OnnxPolicy:
    return OnnxPolicy(write(tmp_path / "risky.onnx", risky=True, risk=RISK))


def test_the_risk_is_that_of_the_observation_and_of_its_recurrence(risky: OnnxPolicy) -> None:
    policy = risky
    assert policy.risk is None
    assert not policy.warning
    policy.act(seen(0.5))
    assert policy.risk == pytest.approx(sigmoid(0.5), abs=1e-6)  # 0.62, nothing came before
    assert not policy.warning
    policy.act(seen(0.5))
    assert policy.risk == pytest.approx(sigmoid(1.0), abs=1e-6)  # 0.73, it repeats
    assert policy.warning
    other = 0.5 + SIZE * RISK["scale"]  # a mean difference of the scale
    policy.act(seen(other))
    assert policy.risk == pytest.approx(sigmoid(other + other / math.e), abs=1e-6)
    policy.reset()
    assert policy.risk is None
    policy.act(seen(0.5))
    assert policy.risk == pytest.approx(sigmoid(0.5), abs=1e-6)


def test_a_robot_that_stands_by_its_odometry_warns(tmp_path: Path) -> None:
    robot = {**METADATA["robot"], "track_speed": 0.2}  # 0.12 m in a decision
    policy = OnnxPolicy(write(tmp_path / "p.onnx", robot=robot, risky=True, risk=RISK))
    for i in range(20):
        policy.act(seen(-1.0), (0.12 * i, 0.0))
        assert not policy.warning
    warnings = []
    for i in range(12):
        policy.act(seen(-1.0), np.array([2.28, 0.02 * (i % 2)]))
        warnings.append(policy.warning)
    assert warnings == [False] * 8 + [True] * 4
    assert policy.risk == pytest.approx(0.85)
    policy.act(seen(-1.0))  # without odometry
    assert not policy.warning


def test_a_position_that_is_none_is_refused(policy: OnnxPolicy) -> None:
    for position, text in (
        ([0.0], r"the position has shape \(1,\); \(2,\) and \(3,\) are allowed"),
        ([0.0, math.nan], "the position is .*finite numbers are allowed"),
        ("ab", "the coordinates are not numbers"),
    ):
        with pytest.raises(FlipperctlError, match=text):
            policy.act(seen(0.5), position)


def test_a_risk_that_is_no_number_is_named(
    risky: OnnxPolicy, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(risky._risk, "_alone", np.full((1, 1), np.nan, np.float32))
    with pytest.raises(NonFiniteError, match=r"risky\.onnx: the risk is not a finite number"):
        risky.act(seen(0.5))


def test_a_policy_with_sides_takes_points_of_both_and_the_roll(tmp_path: Path) -> None:
    policy = OnnxPolicy(write(tmp_path / "sides.onnx", **SIDES))
    level, left = np.array([[-0.5, -0.1], [0.5, -0.1]]), np.array([[0.0, 0.2]])
    angles = {"front": 0.1, "rear": 0.2, "pitch": 0.3}
    equal = policy.observation(level, **angles)
    assert equal.tolist() == pytest.approx([*90 * [-0.1], 0.0, 0.1, 0.2, 0.3])
    found = policy.observation(level, **angles, sides=(left, level), roll=-0.4)
    assert found[:30].tolist() == equal[:30].tolist()
    assert found[30:].tolist() == pytest.approx([*30 * [0.2], *30 * [-0.1], -0.4, 0.1, 0.2, 0.3])
    assert policy.q_values(found)[0] == pytest.approx(0.2)
