"""Parts of all figures: the ground, axes, legends, and writing a figure to a file.

Figures are made without pyplot and its global state.
"""

from __future__ import annotations

import io
import math
import re
import textwrap
from collections.abc import Sequence
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from flipperctl.api import FloatArray, Profile
from flipperctl.figures.render import EARTH, GROUND, INK
from flipperctl.files import OutputKind, check_output, write_bytes

_MARKS = rb"tEXtSoftware\0flipperctl|<dc:title>flipperctl</dc:title>|/Creator \(flipperctl\)"
PICTURE = OutputKind("a picture", (".pdf", ".png", ".svg"), re.compile(_MARKS))
"""Suffixes of the file types that ``save`` writes."""

WIDTH = 9.6
"""Width of every figure [in]."""
_TITLE = 88
"""Largest number of characters of a line of a title [-]."""
_LEGEND = 18.0
"""Height of a legend of one line, with its margins [pt]."""
_LEVEL = 60.0
"""Length of the level ground before and past a profile, and depth of the ground [m]."""
_LEAST = 0.9
"""Smallest height of a picture of ground [in]."""


def draw_ground(axes: Axes, profile: Profile) -> None:
    """Fill the ground, with level ground before and past the profile."""
    line = profile.extended(_LEVEL, _LEVEL)
    axes.fill_between(line[:, 0], line[:, 1], line[:, 1].min() - _LEVEL, color=EARTH, linewidth=0)
    axes.plot(line[:, 0], line[:, 1], color=GROUND, linewidth=1.4)


def z_scale(extent: FloatArray, width: float) -> int:
    """Return the scale of z over that of x at which the picture has the smallest height.

    The picture shows ``extent`` (x, z) [m] and is ``width`` [in] wide. A result of 1 means equal
    scales.
    """
    return max(1, math.ceil(_LEAST * float(extent[0]) / (width * float(extent[1]))))


def scaled(low: FloatArray, high: FloatArray, most: float) -> tuple[int, float]:
    """Return the scale of z, and the height [in] of a picture of the box, from 1 to ``most``."""
    width, extent = WIDTH - 1.0, high - low
    scale = z_scale(extent, width)
    natural = scale * width * float(extent[1] / extent[0])
    return scale, min(max(natural, 1.0), most)


def frame(axes: Axes, low: FloatArray, high: FloatArray, scale: int, title: str = "") -> None:
    """Show the box from ``low`` to ``high``, (x, z) in world [m], with the given scale of z."""
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect(scale, adjustable="box")
    style_axes(axes, title, "x [m]", "z [m]" if scale == 1 else f"z [m], × {scale}")


def style_axes(axes: Axes, title: str, x_label: str, y_label: str) -> None:
    """Set title and labels, draw a light grid and remove the upper and the right spine."""
    lines = "\n".join(textwrap.fill(line, _TITLE) for line in title.splitlines())
    axes.set_title(lines, loc="left", fontsize=11, color=INK, pad=6.0)
    axes.set_xlabel(x_label, fontsize=9, color=INK)
    axes.set_ylabel(y_label, fontsize=9, color=INK)
    axes.tick_params(labelsize=8, colors=INK)
    axes.grid(True, color="#E6E6E6", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def legend_above(axes: Axes, lines: Sequence[Line2D] | None = None) -> None:
    """Place the legend above the right end of the axes, below their title.

    It covers no curve; the title has its final text.
    """
    if title := axes.get_title("left"):
        axes.set_title(title, loc="left", fontsize=11, color=INK, pad=_LEGEND)
    axes.legend(
        handles=lines or axes.get_lines(), loc="lower right", bbox_to_anchor=(1.0, 1.0),
        fontsize=8, frameon=False, ncols=4, borderaxespad=0.0,
    )  # fmt: skip


def save(figure: Figure, path: Path) -> None:
    """Write the figure completely or not at all; equal figures give equal files."""
    check_output(path, PICTURE)
    suffix, buffer = path.suffix.lower(), io.BytesIO()
    undated = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}.get(suffix, {})
    described = {"Software" if suffix == ".png" else "Creator": "flipperctl", **undated}
    with matplotlib.rc_context({"svg.hashsalt": "flipperctl"}):  # otherwise SVG ids are random
        figure.savefig(buffer, format=suffix[1:], dpi=150, metadata=described)
    write_bytes(path, buffer.getvalue())
