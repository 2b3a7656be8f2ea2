"""Write examples of statistics with the numbers of rliable and statsmodels.

    python -m benchmarks.agreement --output tests/evaluation/recorded/agreement.json

``tests/evaluation/test_statistics.py`` compares flipperctl with the stored file, to 1e-9. The
script needs an environment of its own, since rliable 1.2.0 does not import with pandas 3:

    python -m venv other
    other/bin/pip install rliable==1.2.0 arch==7.0.0 "pandas<3" statsmodels "scipy<1.14"

It imports nothing of flipperctl.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

SEED = 20260131
"""Seed of the examples, and of the bootstrap of rliable, which uses NumPy's global generator."""
RESAMPLES = 200
"""Number of bootstrap samples [-]."""
_PACKAGES = ("rliable", "arch", "statsmodels", "scipy", "numpy", "pandas")


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the examples and the versions that made them."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.agreement")
    parser.add_argument("--output", type=Path, required=True, help="file to write")
    chosen = parser.parse_args(arguments)
    rng = np.random.default_rng(SEED)
    document = {
        "made_by": "python -m benchmarks.agreement",
        "versions": {name: version(name) for name in _PACKAGES},
        "seed": SEED,
        "resamples": RESAMPLES,
        "rliable": [_rliable(rng, shape) for shape in ((3, 1, 2), (5, 3, 4), (10, 6, 10))],
        "statsmodels": _statsmodels(rng),
    }
    chosen.output.write_text(json.dumps(document, indent=1) + "\n")
    return 0


def _rliable(rng: np.random.Generator, shape: tuple[int, int, int]) -> dict[str, Any]:
    """Return two methods' scores of some runs on some tasks, with ties, and rliable's numbers."""
    from rliable import library, metrics

    runs, tasks, others = shape
    ours = rng.normal(0.2, 1.0, (runs, tasks)).round(1)
    theirs = rng.exponential(1.0, (others, tasks)).round(1)
    levels = np.linspace(-1, 1, 9)
    np.random.seed(SEED)  # noqa: NPY002
    _, ends = library.get_interval_estimates(
        {"ours": ours},
        lambda scores: np.array([metrics.aggregate_iqm(scores)]),
        reps=RESAMPLES,
    )
    return {
        "ours": ours.tolist(),
        "theirs": theirs.tolist(),
        "levels": levels.tolist(),
        "mean": float(metrics.aggregate_mean(ours)),
        "interquartile_mean": float(metrics.aggregate_iqm(ours)),
        "improvement": float(metrics.probability_of_improvement(ours, theirs)),
        "profile": library.score_distributions(ours, levels).tolist(),
        "interquartile_mean_ends": ends["ours"].ravel().tolist(),
    }


def _statsmodels(rng: np.random.Generator) -> dict[str, Any]:
    from statsmodels.stats.contingency_tables import mcnemar
    from statsmodels.stats.multitest import multipletests
    from statsmodels.stats.proportion import proportion_confint
    from statsmodels.stats.weightstats import DescrStatsW

    values = rng.exponential(1.0, 12)
    described = DescrStatsW(values)
    p_values = rng.uniform(0, 0.1, 7)
    return {
        "mean": {
            "values": values.tolist(),
            "ends": [float(end) for end in described.tconfint_mean()],
            "p": float(described.ttest_mean(0.0)[1]),
        },
        "wilson": [
            {"count": c, "total": n, "ends": list(proportion_confint(c, n, method="wilson"))}
            for c, n in ((1, 5), (37, 40), (90, 200))
        ],
        "mcnemar": [
            {
                "won": won,
                "lost": lost,
                "p": float(mcnemar([[5, won], [lost, 5]], exact=True).pvalue),
            }
            for won, lost in ((3, 0), (9, 2), (12, 17))
        ],
        "holm": {
            "p": p_values.tolist(),
            "corrected": multipletests(p_values, method="holm")[1].tolist(),
        },
        "crossed": _crossed(rng),
    }


def _crossed(rng: np.random.Generator) -> dict[str, Any]:
    """Return scores of seeds × episodes with the mean squares of a two-way analysis of variance."""
    import pandas as pd
    from statsmodels.formula.api import ols
    from statsmodels.stats.anova import anova_lm

    seeds, episodes = 4, 7
    scores = (
        rng.normal(0, 0.3, (seeds, 1))
        + rng.normal(0, 0.5, (1, episodes))
        + rng.normal(2, 0.2, (seeds, episodes))
    )
    rows = [(s, e, scores[s, e]) for s in range(seeds) for e in range(episodes)]
    frame = pd.DataFrame(rows, columns=["seed", "episode", "score"])
    table = anova_lm(ols("score ~ C(seed) + C(episode)", frame).fit())
    squares = table["mean_sq"]
    return {
        "scores": scores.tolist(),
        "seed": float(squares["C(seed)"]),
        "episode": float(squares["C(episode)"]),
        "residual": float(squares["Residual"]),
    }


if __name__ == "__main__":
    raise SystemExit(main())
