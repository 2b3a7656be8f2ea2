"""How every subcommand reads its options: one value for each, and unknown ones explained.

``App.command`` registers functions as ``Command``; nothing else is needed in a subcommand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import typer
from typer.core import TyperCommand, TyperOption

from flipperctl.errors import RequestError


class Command(TyperCommand):
    """A subcommand that refuses an option given twice, and explains an unknown one."""

    foreign_options: ClassVar[Sequence[str]] = ()
    """Options that the subcommand hands on as they are."""
    primary: ClassVar[str] = "eval"
    """What the subcommand's overrides configure: an evaluation or a training."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words behind the subcommand.

        Raises:
            RequestError: an option is unknown, or given twice although it takes one value.
        """
        if not ctx.resilient_parsing:  # shell completion, which reads half a command
            self._check(ctx, args)
        return super().parse_args(ctx, args)

    def _check(self, ctx: Any, args: list[str]) -> None:
        parser = self.make_parser(ctx)
        parser.ignore_unknown_options = True
        options = [p for p in self.get_params(ctx) if isinstance(p, TyperOption)]
        single = [p for p in options if not (p.is_flag or p.multiple or p.count)]
        for option in single:  # collects all values, of which click would keep the last
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
            if name.startswith("-") and name not in known:
                self._refuse(name, args, known)

    def _refuse(self, name: str, args: list[str], known: list[str]) -> None:
        from flipperctl.cli.unknown_option import explain

        names = [word.partition("=")[0] for word in args]
        at = names.index(name) if name in names else len(args)  # a group as in -xm is split
        value = args[at].partition("=")[2] if at < len(args) else ""
        behind = args[at + 1] if at + 1 < len(args) else "-"
        if not value and not behind.startswith("-") and "=" not in behind:
            value = behind
        overridable = any("OVERRIDE" in str(param.metavar) for param in self.params)
        raise RequestError(explain(name, value, known, self.primary if overridable else None))


class TrainingCommand(Command):
    """A subcommand whose overrides configure a training."""

    primary = "train"


def _twice(option: TyperOption, values: Sequence[str]) -> str:
    text = f"{option.opts[0]} is given twice: {values[0]} and {values[1]}; one is allowed"
    if option.metavar == "NAMES":
        text += f"; several names are written as {option.opts[0]} {values[0]},{values[1]}"
    return text


class App(typer.Typer):
    """A Typer application whose subcommands are ``Command``."""

    def command(self, name: str | None = None, **settings: Any) -> Callable[..., Any]:
        """Register a function as a subcommand; see ``typer.Typer.command``."""
        return super().command(name, **{"cls": Command, **settings})
