"""Show a table: on the terminal, as LaTeX, Markdown or HTML, or as rows of a CSV file.

In: a ``Table``, which every view makes, and lines of text. Out: text. On the terminal no number is
truncated: names are folded, headings break at spaces, and columns that are still too wide continue
below. Lines of text have at most 100 columns, or COLUMNS; commands and paths stay whole.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from flipperctl.text.files import OutputKind

_GAP = "  "
_WIDEST = 100  # largest width of a line of text [columns]
_COMMAND = re.compile(r"(?P<before>.*?:|) *(?P<command>flipperctl .+)")  # at the end of a line
_NARROWEST = 14  # smallest width to which a column of names is folded [columns]
_LATEX_HEAD = r"% needs \usepackage{booktabs}"
TABLE = OutputKind("a table", (".tex",), re.compile(rb"\A" + re.escape(_LATEX_HEAD.encode())))
_NEGATIVE = re.compile(r"(?<![\w-])-(?=\d)")
_ESCAPES = str.maketrans(
    {
        **{char: f"\\{char}" for char in "&%$#_{}"},
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        # Without a package, LaTeX has these in mathematics alone.
        "Δ": r"$\Delta$",
        "±": r"$\pm$",
        "−": "$-$",
        "→": r"$\to$",
        "<": "$<$",
        ">": "$>$",
    }
)
NONE = "–"  # text of a missing number
NATURAL = 10_000
"""Width of an output that is not a terminal, so that tables are as wide as they need [columns]."""


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    key: str
    """Key of its values in the rows."""
    heading: str
    digits: int = 2
    """Decimals of its numbers."""
    sign: str = ""
    """``+`` shows the sign of positive numbers too."""
    latex: str = ""
    """Heading in LaTeX; empty for the escaped heading."""
    named: bool = False
    """Whether its texts are names, which may be folded, also within a long one."""
    wrapped: bool = False
    """Whether its texts are sentences, which may be broken at spaces."""


@dataclass
class Table:
    """Columns and rows; a value is a text, a number, an interval or None."""

    columns: Sequence[Column]
    rows: list[dict[str, Any]]
    """Values by key. ``dim`` dims a row, ``line`` leaves a line free above it, and ``style`` is
    rich's."""
    title: str = ""
    notes: list[str] = field(default_factory=list)
    """Lines below the table."""

    def texts(self) -> list[list[str]]:
        """Return the cells of all rows as text."""
        return [[value_text(row.get(c.key), c) for c in self.columns] for row in self.rows]


def value_text(value: Any, column: Column) -> str:
    """Return a value as a cell's text."""
    if isinstance(value, str):
        return value
    if isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    if isinstance(value, float):
        return f"{value:{column.sign}z.{column.digits}f}"
    return interval_text(value, column.digits, sign=column.sign)


def interval_text(interval: Mapping[str, Any] | None, digits: int = 2, *, sign: str = "") -> str:
    """Return ``mean [low, high]``.

    A mean without an interval, or of equal values, is followed by ``[–]``; ``–`` stands for None.
    ``sign`` as in a format specification: ``+`` shows the sign of positive numbers too.
    """
    if interval is None:
        return NONE
    mean, low, high = interval["mean"], interval["low"], interval["high"]
    if low is None or high is None or low == high:
        return f"{mean:{sign}z.{digits}f} [–]"
    mean, low, high = (f"{n:{sign}z.{digits}f}" for n in (mean, low, high))
    return f"{mean} [{low}, {high}]"


def console(*, stderr: bool = False, natural: int = NATURAL) -> Console:
    """Return a console with the width of COLUMNS, else of the terminal, else ``natural``.

    ``natural`` is smaller than its default for tables with long sentences.
    """
    file = sys.stderr if stderr else sys.stdout
    columns = os.environ.get("COLUMNS", "")
    wanted = int(columns) if columns.isdecimal() else 0
    on_terminal = file is not None and file.isatty()
    return Console(stderr=stderr, width=wanted or (None if on_terminal else natural))


def print_text(text: str, *, stderr: bool = False) -> None:
    """Print a text of one or more lines on standard output, or on standard error."""
    print_lines(console(stderr=stderr), text.split("\n"))


def print_lines(to: Console, lines: Iterable[str], style: str = "") -> None:
    """Print each line without markup, broken at spaces where it is too long."""
    _print(to, (part for line in lines for part in _broken(line, to)), style)


def print_facts(facts: Mapping[str, str], to: Console) -> None:
    """Print a line for each name and its text, which goes on below where it is too long."""
    wide = max(map(cell_len, facts), default=0) + 4
    for name, text in facts.items():
        first, *rest = _broken(text, to, wide)
        head = f"  {name}".ljust(wide)
        _print(to, [head + first, *(" " * wide + part for part in rest)])


def print_table(table: Table, to: Console) -> None:
    """Print a table and its notes within the width of the console."""
    _print(to, lines(table, to))
    print_lines(to, table.notes)


def _print(to: Console, lines: Iterable[str | Text], style: str = "") -> None:
    for line in lines:
        to.print(line, style=style, highlight=False, markup=False, soft_wrap=True)


def _broken(line: str, to: Console, indent: int = 0) -> list[str]:
    """Return the lines of a text for a console; ``indent`` columns before it are taken.

    A command at the end, after a colon, gets a line of its own if both are too long for one.
    """
    widest = to.width if "COLUMNS" in os.environ else min(to.width, _WIDEST)
    text, width = line, max(20, widest - indent)
    if cell_len(text) <= width:
        return [text]
    if match := _COMMAND.fullmatch(text):
        before, command = match["before"], match["command"]
        return [*folded(before, width, whole=True), f"  {command}"] if before else [command]
    return folded(text, width, whole=True)


def lines(table: Table, to: Console) -> Iterator[Text]:
    """Yield the lines of a table without its notes."""
    if table.title:
        for text in _broken(table.title, to):
            yield Text(text, "bold")
    # The widths that show everything on one line
    cells = [list(row) for row in table.texts()]
    headings = [column.heading for column in table.columns]
    columns = [[row[at] for row in cells] for at in range(len(headings))]
    cell_widths = [max([1, *map(cell_len, column)]) for column in columns]
    widths = [max(pair) for pair in zip(cell_widths, map(cell_len, headings), strict=True)]

    # Too wide: headings break at spaces, then sentences and names, then names within words.
    words = list(map(_longest_word, headings))
    if _total(widths) > to.width:  # headings break at spaces
        widths = [max(pair) for pair in zip(cell_widths, words, strict=True)]
    names = [at for at, column in enumerate(table.columns) if column.named]
    least = {
        at: max([words[at], *map(_longest_word, columns[at])])
        for at, column in enumerate(table.columns)
        if column.named or column.wrapped
    }
    whole = list(widths)
    _shrink(widths, least, to.width)
    _shrink(widths, dict.fromkeys(names, _NARROWEST), to.width)
    if _total(widths) > to.width:  # columns continue below, which leaves more room
        most = max(_NARROWEST, to.width // 3)
        limits = {at: most if at in names else max(most, least[at]) for at in least}
        widths = [min(width, limits.get(at, width)) for at, width in enumerate(whole)]

    # Parts of the table stand below each other, each with the names at its left.
    for part in _parts(widths, names, to.width):
        yield from _block([folded(headings[at], widths[at]) for at in part], part, widths, "dim")
        for number, (row, texts) in enumerate(zip(table.rows, cells, strict=True)):
            if row.get("line") and number:
                yield Text("")
            broken = [folded(texts[at], widths[at]) for at in part]
            style = "dim" if row.get("dim") else row.get("style", "")
            yield from _block(broken, part, widths, style)


def _shrink(widths: list[int], least: Mapping[int, int], width: int) -> None:
    """Make columns narrower, the widest first, until the table fits or they are at their least."""
    while _total(widths) > width:
        wide = [at for at in least if widths[at] > least[at]]
        if not wide:
            return
        widths[max(wide, key=widths.__getitem__)] -= 1


def _total(widths: Sequence[int]) -> int:
    return sum(widths) + len(_GAP) * (len(widths) - 1)


def _parts(widths: Sequence[int], names: Sequence[int], width: int) -> Iterator[list[int]]:
    """Yield the columns that stand side by side; each part begins with the names."""
    first = [at for at in names if at == names.index(at)]  # the leading ones
    part, used = list(first), sum(widths[at] + len(_GAP) for at in first)
    for at in range(len(widths)):
        if at in first:
            continue
        if used + widths[at] > width and len(part) > len(first):
            yield part
            part, used = list(first), sum(widths[i] + len(_GAP) for i in first)
        part.append(at)
        used += widths[at] + len(_GAP)
    yield part


def _block(
    cells: Sequence[Sequence[str]], part: Sequence[int], widths: Sequence[int], style: str
) -> Iterator[Text]:
    """Yield the lines of one row, whose cells may be folded."""
    for at in range(max(len(cell) for cell in cells)):
        texts = [cell[at] if at < len(cell) else "" for cell in cells]
        padded = [
            text + " " * (widths[column] - cell_len(text))
            for text, column in zip(texts, part, strict=True)
        ]
        yield Text(_GAP.join(padded).rstrip(), style)


def _longest_word(text: str) -> int:
    return max((cell_len(word) for word in text.split()), default=1)


def folded(text: str, width: int, *, whole: bool = False) -> list[str]:
    """Return the lines of a text, broken at spaces; also within too long words unless ``whole``."""
    lines, line = [], ""
    indent = " " * (len(text) - len(text.lstrip()))
    for word in text.split():
        while cell_len(word) > width and not whole:
            if line:
                lines.append(line)
                line = ""
            lines.append(word[:width])
            word = word[width:]
        if line and cell_len(f"{line} {word}") > width:
            lines.append(line)
            line = ""
        line = f"{line} {word}" if line else f"{indent if not lines else ''}{word}"
    return [*lines, line] if line or not lines else lines


def latex(table: Table) -> str:
    """Return a table for LaTeX with booktabs; its title and its notes are comments.

    It is as small as tables of journals are, so that five columns fit into one of a page's two.
    """
    # Names stand at the left of their columns, numbers at the right.
    names = sum(column.named for column in table.columns)
    head = [c.latex or latex_text(c.heading[:1].upper() + c.heading[1:]) for c in table.columns]
    rows_text = [
        _LATEX_HEAD,
        *(f"% {' '.join(text.split())}" for text in (table.title, *table.notes) if text),
        r"{\footnotesize\setlength{\tabcolsep}{2pt}%",
        r"\begin{tabular}{@{}" + "l" * names + "r" * (len(head) - names) + "@{}}",
        r"\toprule",
        " & ".join(head) + r" \\",
        r"\midrule",
    ]

    # A cell that begins with a space is a part of the row above it.
    for at, (row, texts) in enumerate(zip(table.rows, table.texts(), strict=True)):
        if row.get("line") and at:
            rows_text.append(r"\addlinespace")
        # LaTeX's own dash, which every font has; names keep theirs.
        cells = [
            (r"\quad " if text.startswith(" ") else "") + latex_text(text)
            if column.named
            else latex_text(with_minus(text.replace(NONE, "--")))
            for text, column in zip(texts, table.columns, strict=True)
        ]
        rows_text.append(" & ".join(cells) + r" \\")
    return "\n".join([*rows_text, r"\bottomrule", r"\end{tabular}}", ""])


def with_minus(text: str) -> str:
    """Return the text with the sign of its negative numbers as printed matter has it."""
    return _NEGATIVE.sub("−", text)


def latex_text(text: str) -> str:
    """Return the text for LaTeX, on one line."""
    return " ".join(text.split()).translate(_ESCAPES)


def markdown(table: Table) -> list[str]:
    """Return the lines of a table in Markdown."""
    head, *rows = (
        f"| {' | '.join(c)} |" for c in ([c.heading for c in table.columns], *table.texts())
    )
    return [head, "|" + "---|" * len(table.columns), *rows]


def html(table: Table, marks: Mapping[str, str]) -> str:
    """Return a table in HTML, in which intervals have bars from 0 to the largest of their group.

    Rows from one with ``line`` to the next are a group, whose name is the text of the first column.
    ``marks``: names of CSS variables, the colours of rows with these texts.
    """
    # A group's name is a row of its own, so that its column is left out.
    cells, columns = table.texts(), list(table.columns)
    grouped = any(row.get("line") for row in table.rows)
    shown = columns[1:] if grouped else columns
    kinds = ["text" if column.named or column.wrapped else "number" for column in shown]
    body, group = list[str](), list[dict[str, Any]]()

    # Each group begins with a row that has its name alone.
    for at, (row, texts) in enumerate(zip(table.rows, cells, strict=True)):
        if row.get("line") or not at:
            later = (i for i in range(at + 1, len(cells)) if table.rows[i].get("line"))
            group = table.rows[at : next(later, len(cells))]
            if grouped:
                body.append(
                    f'<tr><th class="group" scope="rowgroup" colspan="{len(shown)}">'
                    f"{escape(texts[0])}</th></tr>"
                )
        colour = next((marks[text] for text in texts if text in marks), "")
        style = f' style="--c:var(--{colour})"' if colour else ""
        part = f"{texts[0].strip()}: " if grouped and row.get("dim") else ""
        # The first cell of a group's part is named like the part.
        inner = []
        for column, kind, text in zip(shown, kinds, texts[grouped:], strict=True):
            dot = f'<i class="dot" style="--c:var(--{marks[text]})"></i>' if text in marks else ""
            name = part if column is shown[0] else ""
            bar = _bar(row, column, group) if kind == "number" else ""
            said = with_minus(text) if kind == "number" else text
            # A narrow page breaks a line before an interval, not within it.
            words = re.sub(r"\[[^]]*\]", r'<span class="option">\g<0></span>', escape(name + said))
            inner.append(f'<td class="{kind}">{dot}{words}{bar}</td>')
        body.append(f'<tr class="{"part" * bool(row.get("dim"))}"{style}>{"".join(inner)}</tr>')
        # The axis of the bars stands below the last row of its group.
        scales = [
            _scale(column, group) if k == "number" else None
            for column, k in zip(shown, kinds, strict=True)
        ]
        if row is group[-1] and any(scales):
            ends = [
                with_minus(f"<span>{end[0]:z.2f}</span><span>{end[1]:z.2f}</span>") if end else ""
                for end in scales
            ]
            axes = "".join(f"<td>{text and f'<div class=ends>{text}</div>'}</td>" for text in ends)
            body.append(f'<tr class="axis" aria-hidden="true">{axes}</tr>')

    # Title above, notes below
    title = f'<p class="note">{escape(table.title)}</p>' if table.title else ""
    head = "".join(
        f'<th scope="col" class="{kind}">{escape(column.heading)}</th>'
        for column, kind in zip(shown, kinds, strict=True)
    )
    notes = "".join(f'<p class="note">{escape(with_minus(note))}</p>' for note in table.notes)
    return (
        f'{title}<div class="wide" tabindex="0" role="region" aria-label="{escape(table.title)}">'
        f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table></div>{notes}"
    )


def _scale(column: Column, group: Sequence[Mapping[str, Any]]) -> tuple[float, float] | None:
    """Return the ends of the axis of a group's bars, which includes 0; None without bars."""
    intervals = [cell for other in group if isinstance(cell := other.get(column.key), Mapping)]
    ends = [
        0.0,
        *(cell[k] for cell in intervals for k in ("mean", "low", "high") if cell[k] is not None),
    ]
    return (min(ends), max(ends)) if intervals and min(ends) < max(ends) else None


def _bar(row: Mapping[str, Any], column: Column, group: Sequence[Mapping[str, Any]]) -> str:
    """Return the bar of an interval; an empty one where another row of the group has one."""
    scale, value = _scale(column, group), row.get(column.key)
    if scale is None:
        return ""
    low, high = scale
    parts = []
    if isinstance(value, Mapping):

        def at(number: float) -> str:
            return f"{4 + 92 * (number - low) / (high - low):.1f}%"

        if low < 0:
            parts.append(f'<line class="zero" x1="{at(0)}" x2="{at(0)}" y1="0" y2="100%"/>')
        if value["low"] is not None and value["high"] is not None:
            interval = f'x1="{at(value["low"])}" x2="{at(value["high"])}"'
            parts.append(f'<line {interval} y1="50%" y2="50%"/>')
        parts.append(f'<circle cx="{at(value["mean"])}" cy="50%" r="3.5"/>')
    return f'<svg class="bar" aria-hidden="true">{"".join(parts)}</svg>'
