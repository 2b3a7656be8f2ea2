"""Parse the options of every subcommand: one value for each, and unknown ones are explained.

``App.add`` registers a module with its function ``run`` and its ``HELP`` as a ``Command``. An
``App`` is a ``Group``, which explains unknown options in the same way.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Sequence
from importlib import import_module
from types import ModuleType
from typing import Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from flipperctl.cli.moved import check_moved
from flipperctl.errors import RequestError


class Command(TyperCommand):
    """A subcommand that refuses repeated options and explains unknown ones."""

    foreign_options: ClassVar[Sequence[str]] = ()
    """Options that the subcommand passes on unchanged."""
    context: ClassVar[dict[str, bool]] = {}
    """Settings of click's context."""
    primary: ClassVar[str] = "eval"
    """What the subcommand's overrides configure: an evaluation or a training."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words after the subcommand."""
        if not ctx.resilient_parsing:  # shell completion, which reads incomplete commands
            self._check(ctx, args)
        return super().parse_args(ctx, args)

    def _check(self, ctx: Any, args: list[str]) -> None:
        parser = self.make_parser(ctx)
        parser.ignore_unknown_options = True
        options = [p for p in self.get_params(ctx) if isinstance(p, TyperOption)]
        single = [p for p in options if not (p.is_flag or p.multiple or p.count)]
        for option in single:  # collect all values, of which click would keep the last
            parser.add_option(obj=option, opts=option.opts, dest=option.name, action="append")
        values, words, _ = parser.parse_args(list(args))
        if values.get("help"):
            return
        for option in single:
            if len(given := values.get(option.name) or ()) > 1:
                raise RequestError(_twice(option, given))
        for argument in self.get_params(ctx):
            if argument.param_type_name == "argument" and (found := values.get(argument.name)):
                words += [found] if isinstance(found, str) else found
        known = [name for option in options for name in option.opts] + [*self.foreign_options]
        for word in words:
            name = word.partition("=")[0]
            check_moved(ctx.command_path, name)
            check_moved(ctx.command_path, word)
            if name.startswith("-") and name not in ("-", *known):
                self._refuse(name, args, known)

    def _refuse(self, name: str, args: list[str], known: list[str]) -> None:
        marks = ("OVERRIDE", "[SETTING...]")
        overridable = any(m in str(param.metavar) for param in self.params for m in marks)
        primary = self.primary if overridable else None
        takes_run = any(
            param.param_type_name == "argument" and "RUN" in str(param.metavar)
            for param in self.params
        )
        raise _unknown(name, _value(name, args), known, primary, takes_run=takes_run)


class TrainingCommand(Command):
    """A subcommand whose overrides configure a training."""

    primary = "train"


class Group(TyperGroup):
    """A group of subcommands that explains unknown options before their names."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words up to the name of a subcommand."""
        options = [p for p in self.get_params(ctx) if isinstance(p, TyperOption)]
        known = [name for option in options for name in option.opts]
        for word in [] if ctx.resilient_parsing else args:
            name = word.partition("=")[0]
            if not name.startswith("-") or name in ("-", "--"):
                break
            if name not in known:
                self._refuse(name, args, known)
        return super().parse_args(ctx, args)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the subcommand that the first word names."""
        if not ctx.resilient_parsing:
            check_moved(ctx.command_path, args[0])
        return super().resolve_command(ctx, args)

    def _refuse(self, name: str, args: list[str], known: list[str]) -> None:
        named = next((self.commands[word] for word in args if word in self.commands), None)
        value = "" if (found := _value(name, args)) in self.commands else found
        primary = getattr(named, "primary", TrainingCommand.primary)
        raise _unknown(name, value, known, primary)


def _unknown(
    name: str, value: str, known: list[str], primary: str | None, *, takes_run: bool = False
) -> RequestError:
    """Explain an unknown option by the setting it stands for, or by a close match.

    ``known``: the subcommand's options; ``primary``: the configuration of its overrides;
    ``takes_run``: whether it takes a run or a policy without an option.
    """
    from flipperctl.messages import closest

    key = name.lstrip("-").replace("-", "_")
    start = f"no such option: {name}"
    if found := list(_settings(key, primary)) if primary else []:
        words = (shlex.quote(f"{path}={value}") if value else f"{path}=…" for path in found)
        return RequestError(f"{start}; settings are written as {' or '.join(words)}")
    if name == "--checkpoint" and takes_run:
        return RequestError(f"{start}; write {value or 'the run or policy'} alone")
    if name == "--checkpoint" and primary == "train":
        return RequestError(
            f"{start}; agent.start_from={value or 'RUN_OR_FILE'} begins with its weights, and "
            "--resume goes on with a run"
        )
    options = {option.removeprefix("--"): option for option in known if option.startswith("--")}
    close = closest(name.lstrip("-"), options)
    return RequestError(start + (f"; did you mean {options[close]!r}?" if close else ""))


def _settings(key: str, primary: str) -> Iterator[str]:
    """Yield the paths of settings that equal ``key`` or end with it."""
    from flipperctl import plugins
    from flipperctl.cli.hydra.compose import compose_train, only_one
    from flipperctl.config import EvalConfig
    from flipperctl.config.defaults import CHOICES
    from flipperctl.config.describe import paths_named

    plugins.load()
    config = only_one(compose_train())
    sections = type(config).model_fields if primary == "train" else EvalConfig.model_fields
    yield from paths_named(key, config, sections, CHOICES)


def _value(name: str, args: Sequence[str]) -> str:
    """Return the value that was typed for the option ``name``, or an empty text."""
    names = [word.partition("=")[0] for word in args]
    at = names.index(name) if name in names else len(args)  # a group as in -xm is split
    value = args[at].partition("=")[2] if at < len(args) else ""
    after = args[at + 1] if at + 1 < len(args) else "-"
    return after if not value and not after.startswith("-") and "=" not in after else value


def _twice(option: TyperOption, values: Sequence[str]) -> str:
    text = f"{option.opts[0]} is given twice: {values[0]} and {values[1]}; one is allowed"
    if option.metavar == "NAMES":
        text += f"; several names are written as {option.opts[0]} {values[0]},{values[1]}"
    return text


class App(typer.Typer):
    """A Typer application that is a ``Group`` of ``Command``."""

    def __init__(self, **settings: Any) -> None:
        """Take the settings of ``typer.Typer``."""
        super().__init__(**{"cls": Group, **settings})

    def add(self, name: str, module: ModuleType) -> None:
        """Register a subcommand: the module's ``run``, ``HELP`` and, if it has one, ``COMMAND``.

        ``COMMAND`` is a subclass of ``Command``.
        """
        cls: type[Command] = getattr(module, "COMMAND", Command)
        text = re.sub(r"(?<=\S)\n(?=\S)", " ", module.HELP)  # paragraphs of any width
        self.command(name, help=text, cls=cls, context_settings=cls.context)(module.run)

    def add_group(self, name: str, package: ModuleType) -> None:
        """Register a group of subcommands: the package's ``HELP``, and its modules ``VIEWS``."""
        group = App(name=name, help=package.HELP, no_args_is_help=True, rich_markup_mode="rich")
        for view in package.VIEWS:
            group.add(view, import_module(f"{package.__name__}.{view.replace('-', '_')}"))
        self.add_typer(group)
