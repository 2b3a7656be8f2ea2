"""A table of an evaluation's results beside published ones.

In: the result of an evaluation. Out: a table of the scenes that repeat a published experiment.
"""

from __future__ import annotations

from collections.abc import Iterator

from flipperctl.api import Published, Terrain
from flipperctl.config import resolver, to_dict
from flipperctl.evaluation.results import EvaluationResult, SceneResult
from flipperctl.terminal.pitch_variation import PAPERS_HEADING
from flipperctl.terminal.tables import Table

_TITLE = "beside published results; means over episodes that reached the finish"
_HEADINGS = (
    *("terrain", "of", "episodes", "success"),
    *("t_cost [s]", PAPERS_HEADING, "its range [rad]"),
)


def published_table(result: EvaluationResult, label: str) -> Table | None:
    """Return a row for each such scene and one for what was published; None without such scenes.

    ``label`` is the policy's, if there is only one.
    """
    found = [(scene, known) for scene in result.scenes for known in _published(scene)]
    if not found:
        return None
    table = Table(_HEADINGS, _TITLE)
    for scene, known in found:
        s, label = scene.summary, scene.name.method_text or label
        counts = str(s.episodes), f"{s.success_rate:.3f}"
        if s.t_cost is None or s.pitch_variation is None:
            table.add(s.terrain, label, *counts, "–", "–", "–")
        else:
            variation = f"{s.pitch_variation.mean:.2f}", f"{s.pitch_variation.range:.2f}"
            table.add(s.terrain, label, *counts, f"{s.t_cost.mean:.2f}", *variation)
        theirs = f"{known.pitch_variation:.2f}", f"{known.pitch_variation_range:.2f}"
        table.add("", known.source, "", "", f"{known.t_cost:.2f}", *theirs)
    return table


def _published(scene: SceneResult) -> Iterator[Published]:
    """Yield the results that were published for a scene's terrain under its conditions."""
    terrain = resolver.get("terrain", scene.terrain, "terrain")
    assert issubclass(terrain, Terrain)
    known = terrain.published
    if known is None or known.conditions != scene.conditions.name:
        return
    if scene.conditions.settings["terrain"] == {"name": scene.terrain, **to_dict(terrain())}:
        yield known
