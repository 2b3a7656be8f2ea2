"""Parse the options of every subcommand: one value for each, and unknown ones are explained.

``App.add`` registers a module with its function ``run`` and its ``HELP`` as a ``Command``. An
``App`` is a ``Group``, which explains unknown options in the same way.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from flipperctl.cli.moved import check_moved
from flipperctl.errors import RequestError

if TYPE_CHECKING:
    from flipperctl.config import TrainConfig


class Command(TyperCommand):
    """A subcommand that refuses repeated options and explains unknown ones."""

    foreign_options: ClassVar[Sequence[str]] = ()
    """Options that the subcommand passes on unchanged."""
    context: ClassVar[dict[str, bool]] = {}
    """Settings of click's context."""
    primary: ClassVar[str] = "eval"
    """What the subcommand's overrides configure: an evaluation or a training."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words after the subcommand.

        Raises:
            RequestError: an option is unknown, or given twice although it takes one value.
        """
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
        """Parse the words up to the name of a subcommand.

        Raises:
            RequestError: an option is unknown.
        """
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
        """Return the subcommand that the first word names.

        Raises:
            RequestError: an earlier version had it, and it has moved.
        """
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
    from flipperctl.terminal.unknown_option import explain

    def default() -> TrainConfig:
        from flipperctl.cli.hydra.compose import compose_train, only_one

        return only_one(compose_train())

    return RequestError(explain(name, value, known, primary, default, takes_run=takes_run))


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
