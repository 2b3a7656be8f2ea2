"""The report of an evaluation: one HTML file with words, tables, failures and a player.

In: a folder that ``eval --output`` wrote. Out: a page that needs nothing else, neither a request
nor a framework. The texts, style and script around the numbers are files in ``templates``.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, Outcome
from flipperctl.errors import RequestError
from flipperctl.evaluation.rows import Row
from flipperctl.evaluation.statistics import FEWEST
from flipperctl.evaluation.stored import SUMMARY, read_document
from flipperctl.process.session import command
from flipperctl.rollout.trace import FILE as TRACES
from flipperctl.rollout.trace import Trace, read
from flipperctl.text.files import OutputKind, write_bytes
from flipperctl.text.messages import counted, percent
from flipperctl.text.show import html
from flipperctl.views import evaluation
from flipperctl.views.findings import (
    RULE,
    RULER,
    VARIATION,
    Gaps,
    by_scene,
    findings,
    for_each_seed,
    rank,
    table_rows,
)
from flipperctl.views.origin import origin, typed
from flipperctl.views.published import published
from flipperctl.views.summary import Document

FILE = "report.html"
REPORT = OutputKind(
    "a report", (".html",), re.compile(rb'<meta name="generator" content="flipperctl">')
)
MOST_FAILURES = 24
"""Largest number of failures with a picture [-]."""
_COLOURS = 7  # number of colours of policies in the style [-]
_PERIOD = 2  # poses of a trace for one of the player: 10 Hz [-]
_POINTS = 1500  # largest number of points of a ground [-]


def write(folder: Path, path: Path) -> None:
    """Write the report of a folder of results to ``path``.

    Raises:
        RequestError: the folder holds no results, or a file of it is damaged.
    """
    write_bytes(path, page(folder).encode())


def page(folder: Path) -> str:
    """Return the report of a folder of results; see ``write``."""
    document = read_document(folder)
    recorded = read(folder / TRACES) if (folder / TRACES).exists() else []
    try:
        return _page(folder, document, recorded)
    except (LookupError, TypeError, AttributeError, ValueError) as error:
        raise RequestError(
            f"{folder / SUMMARY}: it holds no results of eval, or those of another version; it "
            f"lacks {error}"
        ) from error


def _page(folder: Path, document: Document, recorded: Sequence[Trace]) -> str:
    # Policies and scenes, in the order of the tables
    rows = table_rows(document)
    policies = list(dict.fromkeys(row["policy"] for row in rows))
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    marks = _marks([*policies, *(trace.policy for trace in recorded)])
    # The published numbers have a section of their own.
    table, *others = evaluation.tables(document, "Policies")
    papers = published(document, strict=False)
    others = [further for further in others if papers is None or further.title != papers.title]
    heat = _heat(rows, policies, scenes, marks) if len(scenes) > 2 and len(policies) > 1 else ""
    template = Template(_text("report.html"))
    return template.substitute(
        title=escape(f"{_several(policies, 'policies')} on {_several(scenes, 'scenes')}"),
        facts=escape(" · ".join(_facts(document))),
        style=_text("report.css"),
        script=_text("report.js"),
        summary=_summary(document, _gaps(folder, policies)),
        results="\n".join([heat, *(html(part, marks) for part in (table, *others))]),
        figures=_figures(folder, document, policies),
        published=_section("The paper's numbers", html(papers, marks)) if papers else "",
        player=_player(recorded),
        failures=_failures(folder, rows, recorded, marks),
        origin=origin(folder, document, marks),
        traces=_data(recorded, marks),
    )


def _marks(names: Sequence[str]) -> dict[str, str]:
    """Return the colour of each policy; the seeds of a method have the method's."""
    from flipperctl.figures.figure import places
    from flipperctl.views.plot import rules

    methods = {name: re.sub(r" \(\d+ seeds\)$|, seed \d+$", "", name) for name in names}
    # As in figures, rules have colours of their own.
    at = places(list(dict.fromkeys(methods.values())), rules())
    colours = {name: f"p{place % _COLOURS}" for name, place in at.items()}
    return {name: colours[method] for name, method in methods.items()} | colours


def _text(name: str) -> str:
    return (files("flipperctl.views") / "templates" / name).read_text(encoding="utf-8")


def _section(title: str, content: str) -> str:
    name = re.sub(r"\W+", "-", title.lower())
    head = f'<h2 id="{name}">{escape(title)}</h2>'
    return f'<section aria-labelledby="{name}">{head}\n{content}</section>'


def _several(names: Sequence[str], noun: str) -> str:
    if len(names) > 3:
        return f"{names[0]}, {names[1]} and {len(names) - 2} more {noun}"
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _facts(document: Document) -> Iterator[str]:
    scenes = document["scenes"]
    if document.get("interrupted"):
        finished, planned = document["finished_episodes"], document["planned_episodes"]
        yield f"interrupted: {finished} of {planned} episodes are finished"
    for noun, values in (
        ("episodes of each policy on a scene", [scene["episodes"] for scene in scenes]),
        ("seed", [scene["seed"] for scene in scenes]),
        ("conditions", [scene["conditions"]["name"] for scene in scenes]),
    ):
        texts = ", ".join(map(str, dict.fromkeys(values)))
        yield f"{texts} {noun}" if noun[0] == "e" else f"{noun} {texts}"


def _gaps(folder: Path, policies: Sequence[str]) -> Gaps:
    """Return the differences of all pairs of policies; none where these cannot be compared."""
    from flipperctl.views.plot import Request, compared, differences

    if len(policies) < 2:
        return {}
    request = Request([str(folder)])
    try:
        comparison, called, _ = compared(request)
        rows = [
            row | {"against": called[other]}
            for other in called
            for row in differences(comparison, called, VARIATION, other)
        ]
    except (RequestError, ValueError):  # as of scenes or settings that not all policies share
        return {}
    # Rows of the table name the number of training seeds.
    names = {re.sub(r" \(\d+ seeds\)$", "", policy): policy for policy in policies}
    scenes = request.scenes()
    return {
        (
            scenes.get(row["scene"], row["scene"]),
            names.get(row["method"], row["method"]),
            names.get(row["against"], row["against"]),
        ): row[VARIATION]
        for row in rows
    }


def _summary(document: Document, gaps: Gaps) -> str:
    lines = []
    for kind, text in findings(document, gaps):
        marked = re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", escape(text))
        lines.append(f'<li class="{kind}">{marked}</li>')
    return (
        f'<ul class="lead">{"".join(lines)}</ul><p class="note">Pitch variation, θ̂<sub>R</sub>, is '
        "how much the robot rocks: the sum of all changes of its pitch in an episode that reached "
        f"the finish. {RULE}</p>"
    )


# Tables


def _heat(
    rows: Sequence[Row],
    policies: Sequence[str],
    scenes: Sequence[str],
    marks: Mapping[str, str],
) -> str:
    """Return the table of policies and scenes; a cell is darker the worse it is on its scene."""
    scene_rows = by_scene(rows)
    # Shades from the least to the largest pitch variation on each scene
    shade: dict[tuple[str, str], float] = {}
    for scene, row_of in scene_rows.items():
        values = {name: row[VARIATION]["mean"] for name, row in row_of.items() if row[VARIATION]}
        low, high = min(values.values(), default=0.0), max(values.values(), default=0.0)
        shade |= {(n, scene): (v - low) / (high - low or 1.0) for n, v in values.items()}
    # The best on each scene, by success first
    best = {scene: max(row_of.values(), key=rank)["policy"] for scene, row_of in scene_rows.items()}
    head = "".join(f'<th scope="col">{escape(scene)}</th>' for scene in scenes)
    # A cell for each policy on each scene
    body = []
    for policy in policies:
        cells = []
        for scene in scenes:
            row = scene_rows[scene].get(policy)
            if row is None:
                cells.append("<td>–</td>")
                continue
            value, success = row[VARIATION], row["success"]["mean"]
            text = f"{value['mean']:.2f}" if value else "–"
            less = f"<small>{percent(success)}</small>" if success < 1 else ""
            kind = ' class="best"' if policy == best[scene] else ""
            heat = shade.get((policy, scene), 1.0)
            cells.append(f'<td{kind} style="--h:{heat:.2f}">{text}{less}</td>')
        name = f'<i class="dot" style="--c:var(--{marks[policy]})"></i>{escape(policy)}'
        body.append(f'<tr><th scope="row">{name}</th>{"".join(cells)}</tr>')
    return (
        '<p class="note">Pitch variation [rad] of each policy on each scene; bold: the best, '
        "darker: worse on this scene, below: success where it is not 100 %</p>"
        '<div class="wide" tabindex="0" role="region" aria-label="Pitch variation by scene">'
        f'<table class="heat"><thead><tr><td></td>{head}</tr></thead>'
        f"<tbody>{''.join(body)}</tbody></table></div>"
    )


# Figures of matplotlib, in the colours of the page


_DRAWN = {
    "differences": "Differences of pitch variation to {ruler} on the same episodes (dots), with "
    "the mean and its interval. A failed episode counts 2π rad, and a crossing at most that.",
    "profiles": "Performance profiles: the share of all episodes that reached the finish with at "
    "most this pitch variation, with 95 % intervals. A curve ends at the success rate.",
}


def _figures(folder: Path, document: Document, policies: Sequence[str]) -> str:
    """Return the figures of several policies; nothing where these have no intervals to compare."""
    if len(policies) < 2 or min(scene["episodes"] for scene in document["scenes"]) < FEWEST:
        return ""
    from flipperctl.figures.figure import COLUMN, WIDTH, render
    from flipperctl.views.plot import KINDS, Request

    # Differences are taken to the usual rule, or else to the last policy.
    ruler = RULER if RULER in policies else policies[-1]
    parts = []
    for kind, caption in _DRAWN.items():
        about, drawn = caption.format(ruler=ruler), ""
        # One for screens, and one for phones
        for width, shown in ((WIDTH, "broad"), (COLUMN, "narrow")):
            try:
                figure, _ = KINDS[kind](Request([str(folder)], against=ruler, width=width))
            except RequestError:  # as of scenes or settings that not all policies share
                continue
            svg = _inline(render(figure, ".svg").decode(), about.partition(".")[0])
            drawn += svg.replace('class="wide"', f'class="{shown}"', 1)
        if not drawn:
            continue
        parts.append(
            f'<figure>{drawn}<figcaption class="note">{escape(about)}</figcaption></figure>'
        )
    return _section("Figures", "\n".join(parts)) if parts else ""


def _inline(svg: str, label: str) -> str:
    """Return an SVG file of matplotlib as a part of the page, with the page's colours."""
    from flipperctl.figures.figure import COLOURS
    from flipperctl.figures.render import FAINT, INK

    # Variables of the page's style replace colours, so that a dark page has its own.
    names = {colour: f"p{at}" for at, colour in enumerate(COLOURS)}
    names |= {INK: "ink", "#606060": "soft", FAINT: "soft", "#E6E6E6": "line", "#FFFFFF": "paper"}
    variables = {colour.lower(): name for colour, name in names.items()}
    # Metadata, comments and digits beyond the second add nothing to a page.
    (box,) = re.findall(r'viewBox="[^"]*"', svg)
    body = svg[svg.index(">", svg.index(box)) + 1 :]
    body = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", body, flags=re.DOTALL)
    body = re.sub(r"\s+", " ", body).replace("*{", ".drawn *{")  # the style of this part alone

    def rounded(path: re.Match[str]) -> str:
        return re.sub(r"(\.\d\d)\d+", r"\1", path[0])

    def variable(match: re.Match[str]) -> str:
        name = variables.get(match[0].lower())
        return f"var(--{name})" if name else match[0]

    body = re.sub(r"#[0-9a-fA-F]{6}\b", variable, re.sub(r' d="[^"]*"', rounded, body))
    return (
        f'<div class="wide" tabindex="0" role="region" aria-label="{escape(label)}">'
        f'<svg class="drawn" role="img" aria-label="{escape(label)}" {box}>{body}</div>'
    )


# Player and failures


def _player(recorded: Sequence[Trace]) -> str:
    if not recorded:
        return _section(
            "Player",
            '<p class="note">These results have no traces of episodes: flipperctl eval with the '
            "same words and --output adds them.</p>",
        )
    return _text("player.html")


def _failures(
    folder: Path, rows: Sequence[Row], recorded: Sequence[Trace], marks: Mapping[str, str]
) -> str:
    number = sum(n for row in rows for o, n in row["counts"].items() if o != Outcome.REACHED)
    if not number:
        return ""
    # A card for each of the first failures, with the command that plays it again
    records = _records(folder)
    failed = [
        (at, record) for at, record in enumerate(recorded) if record.outcome != Outcome.REACHED
    ]
    items = []
    for at, trace in failed[:MOST_FAILURES]:
        about = f"{trace.policy} on {trace.scene}, episode {trace.episode}: {trace.outcome}"
        again = records.get(trace.digest)
        shown = typed(command("replay", again)) if again else ""
        items.append(
            f'<li class="card"><svg class="poster" role="img" data-trace="{at}" '
            f'aria-label="{escape(about)}, its last 6 s"></svg>'
            f'<p><i class="dot" style="--c:var(--{marks[trace.policy]})"></i>'
            f"<b>{escape(trace.policy)}</b> on {escape(trace.scene)}, episode {trace.episode}: "
            f"{escape(trace.outcome)} after "
            f'{trace.time[-1]:.1f} s</p><button type="button" data-trace="{at}">Play</button>'
            f"{shown}</li>"
        )
    more = f"{counted(number, 'episode')} failed{for_each_seed(rows)}; "
    more += f"{len(items)} shown, with the last 6 s of each."
    return _section(
        "Failures",
        f'<p class="note">{more} The command shows the episode again, bit for bit.</p>'
        f'<ul class="failures">{"".join(items)}</ul>',
    )


def _records(folder: Path) -> dict[str, Path]:
    """Return the recorded failures of a folder by the digest of the episode."""
    files: dict[str, Path] = {}
    for file in sorted(folder.glob("failure_*.json")):
        try:
            files.setdefault(json.loads(file.read_text(encoding="utf-8"))["digest"], file)
        except (OSError, ValueError, LookupError, TypeError):
            continue  # replay says why
    return files


def _data(recorded: Sequence[Trace], marks: Mapping[str, str]) -> str:
    """Return what the player shows as JSON that may stand in a page."""
    policies = list(dict.fromkeys(trace.policy for trace in recorded))
    grounds: dict[str, list[list[int]]] = {}
    traces = []
    # Episodes on equal ground share its points.
    for trace in recorded:
        points = _ground(trace)
        key = json.dumps(points)
        grounds.setdefault(key, points)
        place = {"ground": list(grounds).index(key), "policy": policies.index(trace.policy)}
        traces.append(_plain(trace) | place)
    colours = [marks[policy] for policy in policies]
    second = policies.index(RULER) if RULER in policies else 1
    names = {"policies": policies, "colours": colours, "beside": second}
    document = {**names, "grounds": list(grounds.values()), "traces": traces}
    # In a page, a text that looks like the end of the script would be one.
    return json.dumps(document, separators=(",", ":")).replace("<", "\\u003c")


def _plain(trace: Trace) -> dict[str, Any]:
    samples = np.unique([*range(0, len(trace.time), _PERIOD), len(trace.time) - 1])
    # As few numbers as a drawing needs, rounded, since a page holds them all
    columns = {
        "t": trace.time,
        "x": trace.position[:, 0],
        "z": trace.position[:, 1],
        "pitch": trace.pitch,
        "front": trace.front,
        "rear": trace.rear,
    }
    # The player draws the right side, and the left one behind it.
    if trace.flippers.size:
        names = "far_front", "front", "far_rear", "rear"
        columns |= dict(zip(names, trace.flippers.T, strict=True))
    robot = trace.robot
    return {
        "scene": trace.scene,
        "episode": trace.episode,
        "outcome": trace.outcome,
        **{name: _steps(values[samples]) for name, values in columns.items()},
        "robot": [robot.hinge_offset, robot.flipper_axle, robot.track_radius],
        "decided": np.round(trace.decided, 3).tolist(),
        "heights": [
            [None if math.isnan(h) else round(100 * h) for h in row]
            for row in trace.heights.tolist()
        ],
        "bin": round(trace.bin_width, 4),
        **({"risk": np.round(trace.risk, 3).tolist()} if len(trace.risk) else {}),
    }


def _steps(values: FloatArray) -> list[int]:
    """Return differences of consecutive values in thousandths, the first value before them."""
    whole = np.round(1000 * values).astype(np.int64)
    steps: list[int] = np.diff(whole, prepend=0).tolist()
    return steps


def _ground(trace: Trace) -> list[list[int]]:
    """Return the points of the ground around the path, (x, z) in thousandths of a metre."""
    x, points = trace.position[:, 0], trace.ground
    inside = np.flatnonzero((points[:, 0] > x.min() - 3) & (points[:, 0] < x.max() + 3))
    first, last = (inside[0], inside[-1]) if len(inside) else (0, len(points) - 1)
    near = points[max(0, first - 1) : last + 2]
    near = near[:: max(1, -(-len(near) // _POINTS))]
    whole: list[list[int]] = np.round(1000 * near).astype(np.int64).tolist()
    return whole


# Where the numbers come from
