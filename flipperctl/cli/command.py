"""Parse the options of every subcommand: one value for each, and unknown ones are explained."""

from __future__ import annotations

import inspect
import re
import shlex
from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from flipperctl.errors import RequestError


class Command(TyperCommand):
    """A subcommand that refuses repeated options and explains unknown ones."""

    foreign_options: ClassVar[Sequence[str]] = ()
    """Options that the subcommand passes on unchanged."""
    context: ClassVar[dict[str, bool]] = {}
    """Settings of click's context."""
    primary: ClassVar[str] = "eval"
    """What the subcommand's overrides configure: an evaluation or a training."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters; help shows no type behind those without a value."""
        return _without_types(super().get_params(ctx))

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words after the subcommand."""
        from flipperctl.text.files import at_home

        args = at_home(args)
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
            given: list[str] = values.get(option.name) or []
            if len(given) > 1:
                name, first, second = option.opts[0], given[0], given[1]
                text = f"{name} is given twice: {first} and {second}; one is allowed"
                if option.metavar == "NAMES":
                    text += f"; several names are written as {name} {first},{second}"
                raise RequestError(text)
        arguments = [p for p in self.get_params(ctx) if p.param_type_name == "argument"]
        for found in filter(None, (values.get(argument.name) for argument in arguments)):
            words += [found] if isinstance(found, str) else found
        known = [name for option in options for name in option.opts] + [*self.foreign_options]
        for word in words:
            name = word.partition("=")[0]
            if name.startswith("-") and name not in ("-", *known):
                taken = " ".join(str(argument.metavar) for argument in arguments)
                primary = self.primary if re.search(r"OVERRIDE|\[SETTING\.\.\.\]", taken) else None
                value = _value(name, args)
                raise _unknown(name, value, known, primary, takes_run="RUN" in taken)


class TrainingCommand(Command):
    """A subcommand whose overrides configure a training."""

    primary = "train"


class Group(TyperGroup):
    """A group of subcommands that explains unknown options before their names."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters; help shows no type behind those without a value."""
        return _without_types(super().get_params(ctx))

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words up to the name of a subcommand."""
        options = [p for p in self.get_params(ctx) if isinstance(p, TyperOption)]
        known = [name for option in options for name in option.opts]
        for word in [] if ctx.resilient_parsing else args:
            name = word.partition("=")[0]
            if not name.startswith("-") or name in ("-", "--"):
                break
            if name not in known:
                named = next((self.commands[w] for w in args if w in self.commands), None)
                value = "" if (found := _value(name, args)) in self.commands else found
                raise _unknown(name, value, known, getattr(named, "primary", "train"))
        return super().parse_args(ctx, args)


def _without_types(parameters: list[Any]) -> list[Any]:
    for parameter in parameters:
        if getattr(parameter, "is_flag", False):
            parameter.metavar = ""  # in place of <bool>
    return parameters


def _unknown(
    name: str, value: str, known: list[str], primary: str | None, *, takes_run: bool = False
) -> RequestError:
    """Explain an unknown option by the setting it stands for, or by a close match.

    ``known``: the subcommand's options; ``primary``: the configuration of its overrides;
    ``takes_run``: whether it takes a run or a policy without an option.
    """
    from flipperctl.text.messages import closest, suggestion

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
    return RequestError(start + suggestion(*([options[close]] if close else [])))


def _settings(key: str, primary: str) -> Iterator[str]:
    """Yield the paths of settings that equal ``key`` or end with it."""
    from flipperctl.cli.hydra.compose import compose_train, only_one
    from flipperctl.config import EvalConfig
    from flipperctl.config.defaults import CHOICES
    from flipperctl.config.describe import paths_named
    from flipperctl.plugging import plugins

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


class App(typer.Typer):
    """A Typer application that is a ``Group`` of ``Command``."""

    def __init__(self, **settings: Any) -> None:
        """Take the settings of ``typer.Typer``."""
        super().__init__(cls=Group, rich_markup_mode="rich", **settings)

    def add(self, name: str, run: Callable[..., Any], cls: type[Command] = Command) -> None:
        """Register a function as a subcommand, whose help is its docstring."""
        text = re.sub(r"(?<=\S)\n(?=\S)", " ", inspect.getdoc(run) or "")  # paragraphs of any width
        self.command(name, help=text, cls=cls, context_settings=cls.context)(run)
