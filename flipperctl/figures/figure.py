"""The style of every figure, its parts (ground, axes, legends), and writing it to a file.

Sizes hold on paper: a figure as wide as a column of a journal has text of 7 to 8 pt there.
Figures are made without pyplot and its global state.
"""

from __future__ import annotations

import functools
import io
import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Literal, ParamSpec

import matplotlib
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from flipperctl import __version__
from flipperctl.api import FloatArray, Measure, Profile, registry
from flipperctl.env.metrics import heading
from flipperctl.figures import settings
from flipperctl.figures.render import EARTH, FAINT, GROUND, INK
from flipperctl.text.files import OutputKind, check_output, write_bytes

_MARKS = rb"tEXtSoftware\0flipperctl|<dc:title>flipperctl</dc:title>|/Creator \(flipperctl\)"
PICTURE = OutputKind("a picture", (".pdf", ".png", ".svg"), re.compile(_MARKS))
"""Suffixes of the file types that ``save`` writes."""

COLUMN, WIDTH = 3.5, 7.16
"""Width of a column and of the text of a two-column page [in]."""
SLIDE, SCREEN = 10.0, 9.6
"""Width of a figure on a slide, and in a film [in]."""
_SIDE_BY_SIDE = 5.0
"""Width from which panels stand side by side [in]."""
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#AA4499", "#56B4E9", "#E69F00", "#222222")
"""Colours of methods, for colour-blind readers (Okabe and Ito's; the purple is Paul Tol's)."""
LINES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (8, 2)))
MARKERS = ("o", "s", "^", "D", "v", "P", "<")
"""Lines and markers of methods: with 7 colours and markers and 5 lines, 35 methods differ."""
Places = Mapping[str, int]
"""Index of each method's look; methods that are missing have that of their order."""
NO_PLACES: Places = {}
_LEVEL = 60.0
"""Length of the level ground before and past a profile, and depth of the ground [m]."""
_LEAST = 0.09
"""Smallest height of a picture of ground, of its width [-]."""

Style = Literal["paper", "slides", "screen"]
STYLES: dict[Style, dict[str, Any]] = {
    "paper": {"font.size": 8, "xtick.labelsize": 7, "ytick.labelsize": 7, "legend.fontsize": 7},
    "slides": {"font.size": 17, "xtick.labelsize": 15, "ytick.labelsize": 15, "legend.fontsize": 15}
    | {"lines.linewidth": 3.0, "lines.markersize": 8.0, "axes.linewidth": 1.2},
    "screen": {"font.size": 10, "xtick.labelsize": 8, "ytick.labelsize": 8, "legend.fontsize": 8}
    | {"lines.linewidth": 1.6, "lines.markersize": 5.0, "axes.titlesize": 11, "axes.labelsize": 9},
}
_COMMON: dict[str, Any] = {
    "axes.labelsize": "medium",
    "axes.titlesize": "medium",
    "axes.linewidth": 0.6,
    "axes.labelcolor": INK,
    "axes.edgecolor": "#606060",
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.5,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "text.color": INK,
    "legend.frameon": False,
    "legend.handlelength": 1.8,
    "legend.columnspacing": 1.2,
    "legend.handletextpad": 0.5,
    "legend.borderaxespad": 0.2,
}
_settings: Any = matplotlib.rcParams  # whose stubs list every name
_style: ContextVar[Style | None] = ContextVar("style", default=None)


@contextmanager
def styled(style: Style) -> Iterator[None]:
    """Draw in a style, whatever the user's own settings of matplotlib are."""
    before = _style.set(style)
    try:
        with settings(**(_COMMON | STYLES[style])):
            yield
    finally:
        _style.reset(before)


P = ParamSpec("P")


def in_style(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Make a function draw its figure in the ``styled`` style, or else in the style of papers."""

    @functools.wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with styled(_style.get() or "paper"):
            return draw(*args, **kwargs)

    return drawn


def points(size: float) -> float:
    """Return a length in pt that grows with the text of the style; on paper it is ``size``."""
    return float(size * _settings["font.size"] / STYLES["paper"]["font.size"])


def panels(width: float, count: int, height: float) -> tuple[Figure, list[Axes]]:
    """Return a figure with panels, each ``height`` [in]; side by side if there is room for two.

    A panel's quantity belongs above it, since a low panel has no room for it along its axis.
    """
    side_by_side = width >= points(_SIDE_BY_SIDE)
    columns = min(count, 2 if count in (2, 4) else 3) if side_by_side else 1
    rows = -(-count // columns)
    figure = Figure(figsize=(width, rows * height + points(0.3)), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=not side_by_side).flat
    for spare in grid[count:]:
        spare.set_visible(False)
    return figure, list(grid[:count])


def look(index: int, *, marked: bool = True) -> dict[str, Any]:
    """Return colour, line and marker of the method of this index; no marker unless ``marked``."""
    return {
        "color": COLOURS[index % len(COLOURS)],
        "linestyle": LINES[index % len(LINES)],
        "marker": MARKERS[index % len(MARKERS)] if marked else None,
    }


def places(labels: Sequence[str], rules: Sequence[str]) -> dict[str, int]:
    """Return the index of each method's look, which does not depend on what else is drawn.

    ``rules``: names of the known rules, ascending. They have places of their own, from the end of
    the palette; trained policies take the others in their order.
    """
    at: dict[str, int] = {}
    count = len(COLOURS)
    for label in sorted(label for label in labels if label in rules):
        place = count - 1 - rules.index(label) * count // len(rules)
        further = ((place - k) % count for k in range(count))
        at[label] = next((i for i in further if i not in at.values()), count + len(at))
    rest = (i for i in itertools.count() if i not in at.values())
    return at | {label: next(rest) for label in labels if label not in at}


def draw_ground(axes: Axes, profile: Profile) -> None:
    """Fill the ground, with level ground before and past the profile."""
    line = profile.extended(_LEVEL, _LEVEL)
    axes.fill_between(line[:, 0], line[:, 1], line[:, 1].min() - _LEVEL, color=EARTH, linewidth=0)
    axes.plot(line[:, 0], line[:, 1], color=GROUND, linewidth=points(1.0))


def z_scale(extent: FloatArray) -> int:
    """Return by how much z is scaled up against x for a picture of ground of the smallest height.

    The picture shows ``extent`` (x, z) [m]. A result of 1 means equal scales.
    """
    return max(1, math.ceil(_LEAST * float(extent[0] / extent[1])))


def scaled(
    low: FloatArray, high: FloatArray, most: float, width: float = WIDTH
) -> tuple[int, float]:
    """Return the scale of z, and the height [in] of a picture of the box, from 1 to ``most``.

    ``width``: width of the figure, in which axes labels take a part [in].
    """
    inner, extent = width - points(0.6), high - low
    scale = z_scale(extent)
    natural = scale * inner * float(extent[1] / extent[0])
    return scale, min(max(natural, 0.6), most)


def frame(axes: Axes, low: FloatArray, high: FloatArray, scale: int, title: str = "") -> None:
    """Show the box from ``low`` to ``high``, (x, z) in world [m], with the given scale of z."""
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect(scale, adjustable="box")
    height = "Height [m]" if scale == 1 else f"Height [m], × {scale}"
    style_axes(axes, title, "Distance [m]", height)


def style_axes(axes: Axes, title: str, x_label: str, y_label: str) -> None:
    """Set title and labels, draw a light grid and remove the upper and the right spine."""
    axes.set_title(title, loc="left", wrap=True)
    sizes = _settings
    # By its baseline, so that labels with and without a hat stand on one line.
    axes.set_xlabel(x_label, labelpad=1.25 * sizes["font.size"], va="baseline")
    axes.set_ylabel(y_label)
    # Ticks are made when they are drawn, and would have the sizes of that time.
    for axis in ("x", "y"):
        axes.tick_params(
            axis, labelsize=sizes[f"{axis}tick.labelsize"], colors=INK,
            length=sizes[f"{axis}tick.major.size"], width=sizes[f"{axis}tick.major.width"],
        )  # fmt: skip
    axes.grid(visible=True)
    axes.spines[["top", "right"]].set_visible(False)


def legend_above(axes: Axes, lines: Sequence[Line2D]) -> None:
    """Place the legend above the right end of the axes, where it covers no curve."""
    axes.legend(handles=lines, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4)


def legend(figure: Figure, handles: Sequence[Artist]) -> None:
    """Place the legend above all panels, in as few rows as fit into the figure's width."""
    if not handles:
        return
    canvas: Any = FigureCanvasAgg(figure)
    # As many columns as fit, from a single row on
    for columns in range(len(handles), 0, -1):
        placed = figure.legend(handles=handles, loc="outside upper center", ncols=columns)
        if (
            columns == 1
            or placed.get_window_extent(canvas.get_renderer()).width < figure.bbox.width
        ):
            return
        placed.remove()


def note(axes: Axes, text: str) -> None:
    """Write what the reader must know into the middle of an empty panel."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=FAINT)


def render(figure: Figure, suffix: str, about: str = "") -> bytes:
    """Return the file of a figure; ``suffix``: .pdf, .svg or .png.

    ``about``: command, paths and hashes, which stand in the file's metadata with the version of
    flipperctl, and nowhere in the picture. Equal figures give equal files.
    """
    text = "; ".join(part for part in (about, f"flipperctl {__version__}") if part)
    described: dict[str, dict[str, Any]] = {
        ".pdf": {"Creator": "flipperctl", "CreationDate": None, "Subject": text},
        ".svg": {"Creator": "flipperctl", "Date": None, "Description": text},
        ".png": {"Software": "flipperctl", "Description": text},
    }
    # Without a salt, ids of SVG are random; publishers refuse Type 3 fonts, which are the default.
    options = {"svg.hashsalt": "flipperctl", "pdf.fonttype": 42}
    buffer = io.BytesIO()
    with settings(**options):
        figure.savefig(buffer, format=suffix[1:], dpi=200, metadata=described[suffix])
    return buffer.getvalue()


def save(figure: Figure, path: Path, about: str = "") -> None:
    """Write the figure completely or not at all; ``about``: see ``render``."""
    check_output(path, PICTURE)
    write_bytes(path, render(figure, path.suffix.lower(), about))


SUCCESS, VARIATION = "success", "pitch_variation_100hz"
_WORDS = {
    SUCCESS: "Success [%]",
    VARIATION: r"Pitch variation $\hat{\theta}_\mathrm{R}$ [rad]",
    "pitch_variation_decisions": r"Pitch variation $\hat{\theta}_\mathrm{R}$ at decisions [rad]",
    "epsilon": r"Random actions $\varepsilon$",
}


def label(name: str) -> str:
    """Return the label of a column of results, for an axis or above a panel of it alone."""
    if name in _WORDS:
        return _WORDS[name]
    measure, words = registry.get((Measure.kind, name)), name.replace("_", " ")
    if measure is not None and issubclass(measure, Measure):
        words = heading(measure).removesuffix(" [-]")
    return f"{words[0].upper()}{words[1:]}"
