"""Write the files of a new plugin from the templates in this package."""

from __future__ import annotations

import keyword
import shlex
import sys
from dataclasses import dataclass
from importlib.metadata import packages_distributions
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from string import Template

from flipperctl import api
from flipperctl.errors import OutputError, PluginError, RequestError
from flipperctl.plugging import guard
from flipperctl.text.files import failure, make_folder, new_folder
from flipperctl.text.messages import close_match

_REGISTERED = {"engine": "sim", "sensor": "perception", "learner": "agent"}
"""The kind in the registry, and so the key that chooses the plugin, where it is another word."""
_USAGE = {
    "terrain": (
        "flipperctl inspect terrain {name}{plugins} --output {name}.png",
        "flipperctl train terrain={name} --output runs/{name}{plugins}",
        "flipperctl eval runs/{name} --baseline level{plugins}",
    ),
    "reward": (
        "flipperctl inspect reward rewards.{name}={name}{plugins}",
        "flipperctl train rewards.{name}={name}{plugins}",
    ),
    "network": ("flipperctl train network={name}{plugins}",),
    "learner": (
        "flipperctl train agent={name} terrain=step{plugins}",
        "flipperctl train -m agent={name},d3qn seed=1,2 terrain=step{plugins}",
    ),
    "controller": ("flipperctl eval {name} terrain=step{plugins}",),
    "engine": (
        "flipperctl eval okada sim={name} terrain=step{plugins}",
        "flipperctl eval okada sim=planar,{name} terrain=step{plugins}",
    ),
    "sensor": (
        "flipperctl eval okada perception={name} terrain=step{plugins}",
        "flipperctl train perception={name}{plugins}",
    ),
    "measure": (
        "flipperctl eval okada --baseline level terrain=step{plugins}",
        "flipperctl train terrain=step{plugins}",
    ),
    "logger": ("flipperctl train 'logger=[tensorboard,{name}]'{plugins}",),
    "command": ("flipperctl {name} okada{plugins}",),
}


def write_robot(name: str, folder: Path) -> Path:
    """Write ``NAME.yaml``, the body and the devices of a robot, for its builder to change."""
    if not api.is_plugin_name(name):
        raise PluginError(f"robot {name!r}: {api.NAME_RULE}")
    return _write(make_folder(folder) / f"{name}.yaml", _filled("robot.yaml", name=name))


def _filled(template: str, **fields: str) -> str:
    text = files(__package__).joinpath("templates", f"{template}.txt").read_text("utf-8")
    return Template(text).substitute(**fields)


def _write(path: Path, text: str) -> Path:
    """Write a new file, completely or not at all; return its path."""
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        raise _already_exists(path) from error
    except OSError as error:
        path.unlink(missing_ok=True)
        raise failure(path, error) from error
    return path


@dataclass(frozen=True)
class Draft:
    """A plugin to write.

    Raises:
        RequestError: there is no such kind of plugin.
        PluginError: the name is not allowed, or taken.
    """

    kind: str
    name: str

    def __post_init__(self) -> None:
        if self.kind not in _USAGE:
            raise RequestError(
                f"there is no kind {self.kind!r} of plugin{close_match(self.kind, _USAGE)}; "
                f"{', '.join(_USAGE)} and robot are allowed"
            )
        if not api.is_plugin_name(self.name) or keyword.iskeyword(self.name):
            raise PluginError(
                f"plugin name {self.name!r}: {api.NAME_RULE}, and not a keyword of Python"
            )
        if owner := _module_owner(self.name):
            raise PluginError(
                f"plugin name {self.name!r}: {owner} has a module of this name, which a file "
                f"{self.name}.py would hide from scripts beside it; "
                f"{self.name}_{self.kind} is free"
            )
        taken = api.registry.get((_REGISTERED.get(self.kind, self.kind), self.typed))
        if taken is not None:
            raise PluginError(
                f"there is already a {self.kind} plugin {self.name!r}: {guard.definition(taken)}"
            )

    @property
    def cls(self) -> str:
        """Name of the plugin's class, or of the function of a measure or command."""
        if self.kind in ("measure", "command"):
            taken = keyword.iskeyword(self.name) or self.name in (*api.__all__, "Sequence")
            return f"{self.name}_{self.kind}" if taken else self.name
        joined = "".join(word.capitalize() for word in self.name.split("_"))
        clashes = joined in (*api.__all__, "ClassVar", "Field", "Self") or keyword.iskeyword(joined)
        return joined + self.kind.capitalize() if clashes else joined

    @property
    def typed(self) -> str:
        """Name of the plugin as it is typed."""
        return self.name.replace("_", "-") if self.kind == "command" else self.name

    @property
    def package(self) -> str:
        """Import name of the plugin's package."""
        return f"flipperctl_{self.name}"

    def write_file(self, folder: Path) -> Path:
        """Write ``NAME.py``, completely or not at all; return its path."""
        text = self._text(f"{self.kind}.py")
        return _write(make_folder(folder) / f"{self.name}.py", text)

    def write_package(self, folder: Path) -> Path:
        """Write a folder with pyproject, source, test and README, completely or not at all."""
        path, source = make_folder(folder) / self.package, f"src/{self.package}"
        if path.exists():
            raise _already_exists(path)
        texts = {
            "pyproject.toml": self._text("pyproject.toml"),
            "README.md": self._text("README.md"),
            f"{source}/__init__.py": self._text("init.py"),
            f"{source}/{self.name}.py": self._text(f"{self.kind}.py"),
            f"{source}/py.typed": "",
            "tests/test_contract.py": self._text("test.py"),
        }
        with new_folder(path) as part:
            for name, text in texts.items():
                (part / name).parent.mkdir(parents=True, exist_ok=True)
                (part / name).write_text(text, encoding="utf-8")
        return path

    @property
    def _listed(self) -> str:
        """Lines of a project's pyproject.toml by which ``flipperctl --help`` lists a command."""
        place = f"{self.package}.{self.name}:{self.cls}"
        return f'[project.entry-points."flipperctl.commands"]\n{self.typed} = "{place}"\n\n'

    def _text(self, template: str) -> str:
        return _filled(
            template,
            kind=self.kind,
            name=self.name,
            typed=self.typed,
            cls=self.cls,
            listed=self._listed if self.kind == "command" else "",
            package=self.package,
            project=self.package.replace("_", "-"),
            commands="\n".join(usage_commands(self)),
        )


def _module_owner(name: str) -> str | None:
    """Return whose top-level module has this name, if not that of a file in this folder."""
    if name in sys.stdlib_module_names:
        return "Python's standard library"
    spec = find_spec(name)
    if spec is None or spec.origin is None:  # a mere folder, which hides nothing
        return None
    if Path(spec.origin) == Path(f"{name}.py").absolute():
        return None
    owners = packages_distributions().get(name)
    return f"the package {owners[0]}" if owners else spec.origin


def usage_commands(draft: Draft, plugins: str = "") -> list[str]:
    """Return commands that use the plugin; ``plugins`` is the option that loads it."""
    check = "flipperctl inspect plugins {name} --check{plugins}"
    fields = {"name": draft.typed, "plugins": plugins}
    return [command.format(**fields) for command in (check, *_USAGE[draft.kind])]


def next_commands(draft: Draft, written: Path, *, package: bool) -> list[str]:
    """Return the commands to run next."""
    where = shlex.quote(str(written))
    if package:
        return [f"pip install -e {where}", *usage_commands(draft), f"python -m pytest {where}"]
    return usage_commands(draft, f" --plugins {where}")


def _already_exists(path: Path) -> OutputError:
    return OutputError(f"{path} already exists; nothing was written")
