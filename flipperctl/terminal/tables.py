"""Tables on the terminal that never truncate a number.

In: headings and rows. Out: text for the console's width. A table that is wider than the console is
printed row by row, with a line for each cell.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich.cells import cell_len
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table as RichTable
from rich.text import Text

from flipperctl.terminal.console import NATURAL, plain

_NARROWEST = 24
"""Smallest width to which a column of words is wrapped [columns]."""
_INDENT = "  "

Cell = str | Text


class Table:
    """Headings and rows; ``words`` are the headings of columns that may be wrapped at spaces."""

    def __init__(
        self,
        headings: Sequence[str],
        title: str = "",
        *,
        words: Sequence[str] = (),
        right: Sequence[str] = (),
        boxed: bool = True,
    ) -> None:
        """``right`` are headings of right-aligned columns; ``boxed`` draws lines."""
        self.headings, self.title = list(headings), title
        self._words, self._right, self._boxed = set(words), set(right), boxed
        self._rows: list[tuple[list[Cell], bool]] = []
        self._sections: set[int] = set()

    def add(self, *cells: Cell, dim: bool = False) -> None:
        """Add a row with a cell for each heading."""
        if len(cells) != len(self.headings):
            raise ValueError(f"a row of {len(cells)} cells for {len(self.headings)} headings")
        self._rows.append((list(cells), dim))

    def end_section(self) -> None:
        """Draw a line below the newest row."""
        self._sections.add(len(self._rows) - 1)

    def print(self, to: Console) -> None:
        """Print the rows side by side if the console is wide enough, else one by one."""
        options = to.options.update(width=NATURAL)
        for broken in (False, True):
            narrowest = self._side_by_side(to, _NARROWEST, broken)
            if Measurement.get(to, options, narrowest).maximum <= to.width:
                to.print(self._side_by_side(to, None, broken))
                return
        for line in self._one_by_one(to):
            to.print(line, soft_wrap=True)

    def _side_by_side(self, to: Console, widest: int | None, broken: bool) -> RichTable:
        """Return the table; columns of words have at most the width ``widest``.

        With ``broken``, headings that are wider than their cells are broken at spaces.
        """
        title = Text(plain(self.title, to), "italic") if self.title else None
        table = RichTable(title=title, title_justify="left")
        if not self._boxed:
            table.box, table.padding, table.header_style = None, (0, 2), "dim"
        for at, heading in enumerate(self.headings):
            words, shown = heading in self._words, _text(heading, to)
            if broken:
                widest_cell = max((_text(row[at], to).cell_len for row, _ in self._rows), default=0)
                shown = Text("\n").join(_wrapped(shown, widest_cell))
            table.add_column(
                shown,
                no_wrap=not words,
                max_width=widest if words else None,
                overflow="fold",
                justify="right" if heading in self._right else "left",
            )
        for index, (cells, dim) in enumerate(self._rows):
            style = "dim" if dim else None
            ends = index in self._sections
            table.add_row(*(_text(c, to) for c in cells), style=style, end_section=ends)
        return table

    def _one_by_one(self, to: Console) -> Iterator[Text]:
        if self.title:
            yield from _wrapped(_text(self.title, to, "italic"), to.width)
        headings = [_text(heading, to) for heading in self.headings]
        longest = max(heading.cell_len for heading in headings)
        for row, dim in self._rows:
            shown = [(h, _text(c, to)) for h, c in zip(headings, row, strict=True) if len(c) > 0]
            for at, (heading, cell) in enumerate(shown):
                if dim:
                    cell.stylize("dim")
                if at == 0:
                    cell.stylize("bold")
                    before = len(cell) - len(cell.plain.lstrip())
                    yield from _wrapped(cell[before:], to.width, " " * before)
                else:
                    yield from _item(heading, cell, longest, to.width)


def _item(heading: Text, cell: Text, longest: int, width: int) -> Iterator[Text]:
    """Yield the lines of a cell: its heading and its text, wrapped at spaces if too long."""
    space = " " * (longest - heading.cell_len + 2)
    if cell_len(_INDENT) + heading.cell_len + len(space) + cell.cell_len <= width:
        yield Text.assemble(_INDENT, heading, space, cell)
        return
    yield from _wrapped(heading, width, _INDENT)
    yield from _wrapped(cell, width, 2 * _INDENT)


def _wrapped(text: Text, width: int, indent: str = "") -> Iterator[Text]:
    """Yield the lines of a text, wrapped at spaces only."""
    line = Text(indent)
    for word in text.split(" "):
        if line.cell_len > len(indent) and line.cell_len + 1 + word.cell_len > width:
            yield line
            line = Text(indent)
        line = Text.assemble(line, " " if line.cell_len > len(indent) else "", word)
    yield line


def _text(cell: Cell, to: Console, style: str = "") -> Text:
    """Return the cell with characters that the console's stream lacks replaced."""
    if isinstance(cell, Text):
        return cell.copy()
    return Text(plain(cell, to), style)
