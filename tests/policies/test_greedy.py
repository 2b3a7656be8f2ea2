"""The controller that drives by the Q-values of files: of one, of several, and what it refuses."""

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from flipperctl.api import CostPolicy
from flipperctl.config import EnvConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.policies.identity import PolicyIdentity
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import decisions

CONFIG = EnvConfig(terrain="step")


def source(*names: str) -> PolicySource:
    first, *others = names
    return PolicySource(settings={"name": "greedy", "policy": first, "others": others})


def policy(*names: str) -> CostPolicy:
    built = source(*names).build(CONFIG)
    assert isinstance(built, CostPolicy)
    return built


def test_several_policies_drive_by_the_mean_of_their_values() -> None:
    first, second = policy("generalist"), policy("mpc_value")
    both, same = policy("generalist", "mpc_value"), policy("generalist", "generalist")
    for decision in islice(decisions(FlipperEnv(config=CONFIG), both, seed=2), 20):
        p = decision.perception
        mean = (first.costs(p) + second.costs(p)) / 2
        np.testing.assert_allclose(both.costs(p), mean, rtol=1e-6)
        np.testing.assert_allclose(same.costs(p), first.costs(p), rtol=1e-6)
        assert decision.action == mean.argmin()


def test_each_of_several_policies_is_part_of_the_identity(tmp_path: Path) -> None:
    copy = tmp_path / "copy.safetensors"
    copy.write_bytes(Path("flipperctl/policies/mpc_value.safetensors").read_bytes())
    digests = [
        PolicyIdentity.of(source(*names)).digest
        for names in (
            ("generalist",),
            ("generalist", "mpc_value"),
            ("generalist", str(copy)),
            ("mpc_value", "generalist"),
        )
    ]
    assert digests[1] == digests[2], "the content counts, not the place"
    assert len({digests[0], digests[1], digests[3]}) == 3


@pytest.mark.parametrize(
    ("names", "error", "text"),
    [
        (("nowhere",), CheckpointError, r"^controller\.policy: nowhere: there is no such"),
        (("generalist", "nowhere"), CheckpointError, r"^controller\.others\[0\]: nowhere: there"),
        (("",), ConfigError, "policy: '' is no policy of a file"),
        (("", "generalist"), ConfigError, "policy: '' is no policy of a file"),
        (("generalist", ""), CheckpointError, r"^controller\.others\[0\]: "),
    ],
)
def test_what_is_no_policy_is_refused(
    names: tuple[str, ...], error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text):
        source(*names).build(CONFIG)
