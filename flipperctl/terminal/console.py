"""The console for the tables and progress bars of every command."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from typing import Any

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from flipperctl.show import folded
from flipperctl.spelling import spell_plainly

NATURAL = 10_000
"""Width of an output that is not a terminal, so that tables are as wide as they need [columns]."""


class PlainConsole(Console):
    """A console that replaces missing characters before the layout, so columns stay aligned."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Render a text as rich does, with characters that the stream can show."""
        return super().render_str(spell_plainly(text, self.encoding), **options)


def console(*, stderr: bool = False, natural: int = NATURAL) -> Console:
    """Return a console with the width of COLUMNS, else of the terminal, else ``natural``.

    ``natural`` is smaller than its default for tables with long sentences.
    """
    file = sys.stderr if stderr else sys.stdout
    columns = os.environ.get("COLUMNS", "")
    wanted = int(columns) if columns.isdecimal() else 0
    on_terminal = file is not None and file.isatty()
    return PlainConsole(stderr=stderr, width=wanted or (None if on_terminal else natural))


def print_lines(to: Console, lines: Iterable[str], style: str = "") -> None:
    """Print each line without markup, broken at spaces where it is too long for the console."""
    for line in lines:
        text = spell_plainly(line, to.encoding)
        for part in folded(text, to.width) if cell_len(text) > to.width else [text]:
            to.print(part, style=style, highlight=False, markup=False, soft_wrap=True)
