"""From an empty folder to a crossed step on topics, by the commands of docs/ros.md alone."""

import io
import re
import shlex
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from tests.cli.call import call
from tests.ros.distributions import ROOT, Ros

PAGE = (ROOT / "docs" / "ros.md").read_text()
WALK = PAGE.partition("### From an empty folder to a crossed step")[2].partition("\n## ")[0]
NODE = "ros2 run flipperctl_ros node "


def edit(draft: Any, changes: Mapping[str, Any]) -> None:
    """Change values of the draft; each is there, or a builder would not find where it goes."""
    for key, value in changes.items():
        assert key in draft, key
        if isinstance(value, Mapping):
            edit(draft[key], value)
        else:
            draft[key] = value


@pytest.mark.ros
@pytest.mark.long
def test_a_builder_with_another_robot_crosses_a_step_on_topics(ros: Ros, tmp_path: Path) -> None:
    """No line of Python is edited; ``ros2 run`` is not among the wheels, and starts a module."""
    (draft,) = re.findall(r"`flipperctl (new robot \w+)`", WALK)
    (changes,) = re.findall(r"```yaml\n(.*?)```", WALK, re.DOTALL)
    lines = "".join(re.findall(r"```text\n(.*?)```", WALK, re.DOTALL)).splitlines()
    *before, node, robot = lines

    # The file of the robot: the draft with other values
    assert call(*draft.split(), cwd=tmp_path).code == 0
    file, yaml = tmp_path / f"{draft.split()[-1]}.yaml", YAML()
    settings = yaml.load(file.read_text())
    edit(settings, yaml.load(changes))
    text = io.StringIO()
    yaml.dump(settings, text)
    file.write_text(text.getvalue())

    # The policy for it, and whether the sensing does
    assert {line.split()[0] for line in before} == {"flipperctl"}
    for line in before:
        done = call(*shlex.split(line)[1:], cwd=tmp_path)
        assert done.code == 0, (line, done.err)
    assert "/front/points" in done.out
    assert "scans refused      0" in done.out

    # The node, and a robot on its topics
    assert node.startswith(NODE)
    with ros.node_of(shlex.split(node.removeprefix(NODE)), cwd=tmp_path):
        command = [sys.executable, "-m", *shlex.split(robot)]
        done = subprocess.run(
            command,
            cwd=tmp_path,
            env=ros.variables | {"PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
        )
    assert done.returncode == 0, done.stderr
    assert re.search(r"^0 +reached ", done.stdout, re.MULTILINE), done.stdout
