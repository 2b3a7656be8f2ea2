"""Write examples of statistics with the numbers of rliable and statsmodels.

    python -m benchmarks.agreement --output tests/evaluation/recorded/agreement.json

``tests/evaluation/test_agreement.py`` compares flipperctl with the stored file, to 1e-9. The script
needs an environment of its own, since rliable 1.2.0 does not import with pandas 3:

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
    from statsmodels.stats.power import TTestPower
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
        "power": [
            {
                "difference": d,
                "deviation": s,
                "episodes": n,
                "power": float(TTestPower().power(d / s, n, 0.05)),
                "integral": _power(d / s, n),
            }
            for d, s, n in ((0.1, 0.5, 20), (0.1, 0.5, 199), (0.5, 0.4, 6), (0.02, 0.3, 40))
        ],
        "episodes": [
            {
                "difference": d,
                "deviation": s,
                "episodes": float(TTestPower().solve_power(d / s, alpha=0.05, power=0.8)),
            }
            for d, s in ((0.1, 0.5), (0.5, 0.4), (0.02, 0.3))
        ],
        "crossed": _crossed(rng),
    }


def _power(effect: float, pairs: int) -> float:
    """Return the power of the paired t test by numerical integration over the deviation.

    It is the reference to 1e-9: statsmodels takes the noncentral t distribution from
    ``scipy.special.nctdtr``, which errs by 1e-8.
    """
    from scipy.integrate import quad
    from scipy.special import ndtr
    from scipy.stats import chi, t

    freedom, shift = pairs - 1, effect * pairs**0.5
    limit = t.isf(0.025, freedom)

    def density(deviation: float) -> float:
        at = limit * deviation / freedom**0.5
        return float(chi.pdf(deviation, freedom) * (ndtr(shift - at) + ndtr(-shift - at)))

    middle = freedom**0.5
    ends = (max(0.0, middle - 9), middle + 9)
    return float(quad(density, *ends, epsabs=1e-13, epsrel=1e-12, limit=200)[0])


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
