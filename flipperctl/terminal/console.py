"""The console on which every command prints its tables and bars."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from typing import Any

from rich.console import Console
from rich.text import Text

from flipperctl.terminal.streams import spell_plainly

NATURAL = 10_000
"""Columns of an output that is not a terminal, so that tables take the width they need."""


class PlainConsole(Console):
    """A console that replaces characters the stream lacks before layout: columns stay aligned."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Render a text as rich does, with characters that the stream can show."""
        return super().render_str(spell_plainly(text, self.encoding), **options)


def console(*, stderr: bool = False, natural: int = NATURAL) -> Console:
    """Return a console with the width of COLUMNS, else of the terminal, else ``natural``.

    The latter is that of the tables unless a table has long sentences.
    """
    file = sys.stderr if stderr else sys.stdout
    columns = os.environ.get("COLUMNS", "")
    wanted = int(columns) if columns.isdecimal() else 0
    on_terminal = file is not None and file.isatty()
    return PlainConsole(stderr=stderr, width=wanted or (None if on_terminal else natural))


def print_lines(to: Console, lines: Iterable[str]) -> None:
    """Print each line as it is, without markup and without breaks."""
    for line in lines:
        to.print(line, highlight=False, markup=False, soft_wrap=True)


def plain(text: str, of: Console) -> str:
    """Return the text as the console's stream shows it, for a ``rich.text.Text``."""
    return spell_plainly(text, of.encoding)
