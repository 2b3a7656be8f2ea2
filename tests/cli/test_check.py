"""``flipperctl inspect plugins --check`` as a user types it."""

import json
from pathlib import Path

from tests.cli.call import call, refused

WALL = '''
from pydantic import Field
from flipperctl.api import Profile, Terrain, terrain

@terrain("wall")
class Wall(Terrain):
    """A wall."""
    height: float = Field(0.2, ge=0, le=30, description="height [m]")

    def generate(self, rng):
        return Profile([(0, 0), (0, self.height)])
'''


def test_a_plugin_that_fails_is_named_with_check_and_value(tmp_path: Path) -> None:
    (tmp_path / "wall.py").write_text(WALL)
    check = ["inspect", "plugins", "wall", "--check", "--plugins", "wall.py"]
    done = call(*check, cwd=tmp_path)
    assert done.code == 1
    assert done.err == "error: 1 of 10 checks failed: terrain wall (extent)\n"
    assert "with height=30: it reaches 30 m" in " ".join(done.out.split())
    rows = {row["check"]: row for row in json.loads(call(*check, "--json", cwd=tmp_path).out)}
    assert [name for name, row in rows.items() if not row["ok"]] == ["extent"]
    assert "20 m is allowed" in rows["extent"]["message"]
    assert rows["start"]["seconds"] > 0


def test_pictures_show_each_bound(tmp_path: Path) -> None:
    done = call("inspect", "plugins", "flat", "--check", "--output", "pictures", cwd=tmp_path)
    assert done.code == 0, done.err
    assert (tmp_path / "pictures" / "flat.png").read_bytes().startswith(b"\x89PNG")
    assert "--check" in refused("inspect", "plugins", "flat", "--output", "x", cwd=tmp_path)


def test_a_plugin_that_would_leave_fails_its_checks_with_file_and_line(tmp_path: Path) -> None:
    line = "        raise SystemExit(0)\n"
    (tmp_path / "wall.py").write_text(WALL.rpartition("        return")[0] + line)
    check = ["inspect", "plugins", "wall", "--check", "--json", "--plugins", "wall.py"]
    done = call(*check, cwd=tmp_path)
    assert done.code == 1
    rows = {row["check"]: row for row in json.loads(done.out)}
    where = f"SystemExit: 0 ({tmp_path / 'wall.py'}:11)"
    assert where in rows["draws"]["message"]
    assert rows["documented"]["ok"]
