"""The policy as the robot runs it: its decisions, its errors and its imports."""

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from flipperctl.errors import MissingExtraError, NonFiniteError, PolicyError
from flipperctl.runtime import OnnxPolicy
from tests.runtime.linear import METADATA, write


@pytest.fixture
def policy(tmp_path: Path) -> OnnxPolicy:
    return OnnxPolicy(write(tmp_path / "p.onnx"))


def observation(highest: int) -> np.ndarray:
    """Return an observation of zeros but one height."""
    return np.eye(18)[highest] * 0.3


def test_the_action_of_the_largest_q_value_is_taken(policy: OnnxPolicy) -> None:
    assert [policy.act(observation(a)) for a in (4, 0, 8)] == [4, 0, 8]
    assert policy.act(list(observation(7))) == 7
    assert policy.act(observation(2).astype(np.float32)) == 2
    assert policy.act(-1.0 - observation(3)[::-1]) == 0  # all equal: the first


def test_q_values_of_one_and_of_many(policy: OnnxPolicy) -> None:
    one = policy.q_values(observation(4))
    assert one.tolist() == pytest.approx([0, 0, 0, 0, 0.3, 0, 0, 0, 0])
    many = policy.q_values(np.stack([observation(a) for a in (1, 5, 6)]))
    assert many.shape == (3, 9)
    assert many.argmax(1).tolist() == [1, 5, 6]
    assert policy.q_values(np.zeros((0, 18))).shape == (0, 9)


def test_a_decision_changes_neither_earlier_values_nor_the_observation(policy: OnnxPolicy) -> None:
    given = observation(4)
    first = policy.q_values(given)
    policy.act(observation(6))
    assert first[4] == pytest.approx(0.3)
    assert given.tolist() == observation(4).tolist()


@pytest.mark.parametrize("shape", [(17,), (1, 18), (18, 1), ()])
def test_act_refuses_another_shape(policy: OnnxPolicy, shape: tuple[int, ...]) -> None:
    with pytest.raises(PolicyError, match=r"shape .*\(18,\) is allowed: 15 terrain heights and 3"):
        policy.act(np.zeros(shape))


@pytest.mark.parametrize("shape", [(17,), (2, 17), (2, 1, 18), ()])
def test_q_values_refuse_another_shape(policy: OnnxPolicy, shape: tuple[int, ...]) -> None:
    with pytest.raises(PolicyError, match=r"\(18,\) or \(B, 18\) is allowed"):
        policy.q_values(np.zeros(shape))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_an_observation_that_is_not_finite_is_named(policy: OnnxPolicy, bad: float) -> None:
    wrong = observation(4)
    wrong[16] = bad
    with pytest.raises(NonFiniteError, match=rf"observation\[16\] \(theta_f2\) is {bad}"):
        policy.act(wrong)
    with pytest.raises(NonFiniteError, match=r"observation\[1, 16\] \(theta_f2\)"):
        policy.q_values([observation(4), wrong])
    assert policy.act(observation(5)) == 5  # the next decision is right again


def test_a_policy_of_several_frames_keeps_the_observations_before(tmp_path: Path) -> None:
    # 9 heights and angles of 3 frames; its Q-values are the first 9 numbers: the oldest frame
    entries = METADATA["observation"][:6] + METADATA["observation"][-3:]
    path = write(tmp_path / "p.onnx", size=27, bins=6, observation=entries, frames=3)
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


@pytest.mark.parametrize(
    ("at", "value", "text"),
    [
        (17, 20.0, r"\[17\] \(theta_R\) is 20 rad; ±π is allowed: angles are in radians"),
        (15, -3.2, r"\[15\] \(theta_f1\) is -3\.2 rad"),
        # 5 m and half of 15 bins of 0.15 m
        (3, -100.0, r"\[3\] \(h_4\) is -100 m; ±6\.125 m is allowed: heights are in metres"),
        (14, 6.2, r"\[14\] \(h_15\) is 6\.2 m"),
    ],
)
def test_an_observation_in_another_unit_is_refused(
    policy: OnnxPolicy, at: int, value: float, text: str
) -> None:
    wrong = observation(4)
    wrong[at] = value
    with pytest.raises(PolicyError, match=text):
        policy.act(wrong)
    with pytest.raises(PolicyError, match=r"observation\[1, "):
        policy.q_values([observation(4), wrong])
    assert policy.act(observation(5)) == 5  # the next decision is right again


def test_the_largest_plausible_numbers_are_accepted(policy: OnnxPolicy) -> None:
    largest = np.array([6.125] * 15 + [math.pi] * 3)
    assert policy.interface.limits == pytest.approx(largest)
    for sign in (-1, 1):
        policy.act(sign * largest)
        policy.act(sign * largest.astype(np.float32))


def test_an_observation_that_is_not_numbers_is_refused(policy: OnnxPolicy) -> None:
    with pytest.raises(PolicyError, match="is not numbers"):
        policy.act(["steep"] * 18)
    for odd in (["0.1"] * 18, np.full(18, 1j), [10**400] * 18):
        with pytest.raises(PolicyError, match="is not numbers"):
            policy.act(odd)
        with pytest.raises(PolicyError, match="is not numbers"):
            policy.q_values(odd)
    for odd in ("1", 1j, 10**400):
        with pytest.raises(PolicyError, match="the targets are not numbers"):
            policy.next_targets((odd, 0), (0, 0), 0)
        with pytest.raises(PolicyError, match="the points are not numbers"):
            policy.observation([[0, odd]], front=0, rear=0, pitch=0)
    for odd in (10**400, 1e300):
        with pytest.raises(NonFiniteError, match="front is 1"):
            policy.observation([[0, 0]], front=odd, rear=0, pitch=0)
    with pytest.raises(PolicyError, match=r"no observation \(None\); 18 numbers are needed"):
        policy.act(None)


def test_a_q_value_that_is_not_finite_is_no_action(tmp_path: Path) -> None:
    policy = OnnxPolicy(write(tmp_path / "p.onnx", scale=3e38))
    with pytest.raises(NonFiniteError, match="Q-value of action 4 is inf"):
        policy.act(observation(4) * 4)
    with pytest.raises(NonFiniteError, match="Q-value of action 4 is inf"):
        policy.q_values(observation(4) * 4)
    with pytest.raises(NonFiniteError, match="Q-value of action 0 is nan"):
        OnnxPolicy(write(tmp_path / "q.onnx", scale=math.nan))


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
    with pytest.raises(MissingExtraError, match=r"onnxruntime; install flipperctl\[robot\]"):
        OnnxPolicy(tmp_path / "p.onnx")


def test_a_robot_needs_only_numpy_and_onnxruntime(tmp_path: Path) -> None:
    path = write(tmp_path / "p.onnx")
    absent = ["torch", "pymunk", "pydantic", "gymnasium", "hydra", "omegaconf", "matplotlib"]
    absent += ["typer", "rich", "safetensors", "onnx", "numba", "scipy"]
    script = (
        f"import sys; sys.modules.update(dict.fromkeys({absent!r}))\n"
        "from flipperctl.runtime import OnnxPolicy\n"
        f"policy = OnnxPolicy({str(path)!r})\n"
        "observation = [0.0] * 18; observation[6] = 0.2\n"
        "print(policy.act(observation), policy.q_values(observation)[6])\n"
        f"assert not any(sys.modules[name] for name in {absent!r})"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["6", "0.2"]
