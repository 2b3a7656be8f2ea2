"""Parse the options of every subcommand: one value for each, and unknown ones are explained.

Subcommands are converted from functions when they are needed: help lists them without that.
"""

from __future__ import annotations

import copy
import inspect
import re
from collections.abc import Callable, Iterator, MutableMapping, Sequence
from itertools import pairwise
from typing import Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption
from typer.exceptions import TyperException

from flipperctl.cli import plugged
from flipperctl.errors import FlipperctlError, RequestError
from flipperctl.terminal.streams import print_note
from flipperctl.text.elsewhere import called_here


class Command(TyperCommand):
    """A subcommand that refuses repeated options and explains unknown ones."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters with the words by which help and errors name their values."""
        return _with_words(super().get_params(ctx))

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
            names, nargs = option.opts, option.nargs
            parser.add_option(option, opts=names, dest=option.name, action="append", nargs=nargs)
        try:
            values, words, _ = parser.parse_args(list(args))
        except TyperException as error:
            name = getattr(error, "option_name", "")
            for option in (o for o in options if name in o.opts and not o.is_flag):
                text = f"{name} {option.metavar}: {option.metavar} is missing"
                raise RequestError(f"{text}; see {ctx.command_path} --help") from error
            raise
        if values.get("help"):
            return
        for option in single:
            repeated: list[str] = values.get(option.name) or []
            if len(repeated) > 1:
                name, first, second = option.opts[0], repeated[0], repeated[1]
                text = f"{name} is given twice: {first} and {second}; one is allowed"
                if option.metavar == "NAMES":
                    text += f"; several names are written as {name} {first},{second}"
                raise RequestError(text)
        arguments = [p for p in self.get_params(ctx) if p.param_type_name == "argument"]
        for typed in filter(None, (values.get(argument.name) for argument in arguments)):
            words += [typed] if isinstance(typed, str) else typed
        known = [name for option in options for name in option.opts]
        _refuse_unknown(words, known)


class Subcommands(MutableMapping[str, Any]):
    """The subcommands of a group by name; each is converted when it is first asked for."""

    def __init__(self, app: App) -> None:
        """Begin with those of ``app`` and of plugins."""
        self._app = app
        self._converted: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        """Return the subcommand or group; KeyError if there is none."""
        if name not in self._converted:
            self._converted[name] = self._app.convert(name)
        return self._converted[name]

    def __setitem__(self, name: str, converted: Any) -> None:
        self._converted[name] = converted

    def __delitem__(self, name: str) -> None:
        del self._converted[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._app.names())

    def __len__(self) -> int:
        return len(self._app.names())


class Group(TyperGroup):
    """A group of subcommands that explains unknown options before their names."""

    app: ClassVar[App]

    def __init__(self, **settings: Any) -> None:
        """Take the settings of typer's group; the subcommands are those of ``app``."""
        super().__init__(**settings)
        self.commands = Subcommands(self.app)

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the subcommands."""
        return list(self.commands)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the subcommand that the words begin with, also one of a file of ``--plugins``."""
        if args[0] not in self.commands and not ctx.resilient_parsing:
            plugged.load_files(args)
        if args[0] not in self.commands and (hint := called_here(args[0])):
            raise RequestError(f"there is no command {args[0]!r}{hint}")
        return super().resolve_command(ctx, args)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help, for which no subcommand is converted."""
        plugged.load_variable()
        listed = copy.copy(self)
        listed.commands = {
            name: TyperCommand(name=name, help=text) for name, text in self.app.summaries()
        }
        TyperGroup.format_help(listed, ctx, formatter)

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters with the words by which help and errors name their values."""
        return _with_words(super().get_params(ctx))

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words up to the name of a subcommand."""
        options = [p for p in self.get_params(ctx) if isinstance(p, TyperOption)]
        known = [name for option in options for name in option.opts]
        ends = (at for at, word in enumerate(args) if not word.startswith("-") or word == "--")
        if not ctx.resilient_parsing:  # words up to the subcommand
            _refuse_unknown(args[: next(ends, len(args))], known)
        return super().parse_args(ctx, args)


def _with_words(parameters: list[Any]) -> list[Any]:
    for parameter in parameters:
        if getattr(parameter, "is_flag", False):
            parameter.metavar = ""  # in place of <bool>
        elif parameter.param_type_name == "argument" and not parameter.metavar:
            parameter.metavar = parameter.name.upper()  # as the text of the help calls it
    return parameters


def _refuse_unknown(words: Sequence[str], known: Sequence[str]) -> None:
    """Refuse an option among the words that is not ``known``, with a close match."""
    from flipperctl.text.messages import closest, suggestion

    for word, following in pairwise([*words, ""]):
        name, _, value = word.partition("=")
        if word.startswith("-") and name not in ("-", *known):
            long = {option.removeprefix("--"): option for option in known if option[:2] == "--"}
            close = closest(name.lstrip("-"), long)
            hint = called_here(name) and (called_here(value or following) or called_here(name))
            hint = hint or suggestion(*([long[close]] if close else []))
            written = hint or "; policies are words, and settings key=value"
            raise RequestError(f"no such option: {name}{written}")


class App(typer.Typer):
    """A Typer application that is a ``Group`` of ``Command``."""

    def __init__(
        self, words: plugged.Words = (), order: Sequence[str] = (), **settings: Any
    ) -> None:
        """Take the settings of ``typer.Typer``.

        ``words``: those that are typed for the group; ``order``: of its subcommands in help, before
        those that are not named.
        """
        self._words, self._order = words, order
        self._functions: dict[str, Callable[..., Any]] = {}
        self._groups: dict[str, App] = {}
        cls = type("Group", (Group,), {"app": self})
        super().__init__(
            cls=cls, rich_markup_mode="rich", pretty_exceptions_enable=False, **settings
        )

    def add(self, name: str, run: Callable[..., Any]) -> None:
        """Register a function as a subcommand, whose help is its docstring."""
        self._functions[name] = run

    def group(self, name: str, text: str) -> App:
        """Return a new group of subcommands with this help."""
        self._groups[name] = App(
            (*self._words, name),
            name=name,
            help=text,
            no_args_is_help=True,
            add_completion=False,
            callback=lambda: None,
            context_settings=NO_FLAGS,
        )
        return self._groups[name]

    def names(self) -> list[str]:
        """Return the names of all subcommands, in the order of help."""
        names = dict.fromkeys([*self._functions, *self._groups, *plugged.names(self._words)])
        first = [name for name in self._order if name in names]
        return list(dict.fromkeys([*first, *names]))

    def convert(self, name: str) -> Any:
        """Return the subcommand or group of a name as click has it; KeyError if there is none."""
        if (group := self._group(name)) is not None:
            return typer.main.get_command(group)
        run = self._function(name)
        if name not in self._functions:
            run = plugged.with_plugins(run)
        alone = typer.Typer(
            add_completion=False, rich_markup_mode="rich", pretty_exceptions_enable=False
        )
        alone.command(name, help=_help(run), cls=Command)(run)
        return typer.main.get_command(alone)

    def summaries(self) -> Iterator[tuple[str, str]]:
        """Yield name and help of each subcommand; one that does not load is a warning."""
        for name in self.names():
            try:
                group = self._group(name)
                yield name, str(group.info.help) if group else _help(self._function(name))
            except FlipperctlError as error:
                print_note(f"warning: {error}")

    def _group(self, name: str) -> App | None:
        """Return the group of a name, which plugins may have begun; None if it is none."""
        words = (*self._words, name)
        if name not in self._groups and name not in self._functions and plugged.names(words):
            self.group(name, plugged.help_text(words))
        return self._groups.get(name)

    def _function(self, name: str) -> Callable[..., Any]:
        return self._functions.get(name) or plugged.function((*self._words, name))


NO_FLAGS = {"default_map": {"help": False}}
"""Without this default, Typer imports pydantic to validate an absent flag of a group, which delays
help by 65 ms."""


def _help(run: Callable[..., Any]) -> str:
    """Return a function's docstring with paragraphs that fill any width."""
    return re.sub(r"(?<=\S)\n(?=\S)", " ", inspect.getdoc(run) or "")
