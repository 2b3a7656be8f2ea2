"""The fit of the model of a map's errors, on errors of known size."""

import numpy as np
import pytest

from benchmarks import map_errors
from benchmarks.map_errors import (
    Errors,
    correlation_along,
    correlation_in_time,
    fit,
    scale,
    with_jitter,
)
from flipperctl.errors import RequestError
from flipperctl.sim.planar.map_errors import NEAREST, MapErrorSize, correlated

WIDTH = 0.15


def level(height: float, length: float) -> Errors:
    """Errors of a process of this size over level ground, averaged over bins of 10 points."""
    x = np.arange(1200 * 15 * 10) * WIDTH / 10
    values = height * correlated(x, length, np.random.default_rng(4))
    errors = values.reshape(1200, 15, 10).mean(axis=2)
    return Errors(errors, np.zeros_like(errors), WIDTH)


def sloped(drift: float, slope: float) -> Errors:
    """Errors by displacements of ground on a slope, which were driven since it was passed."""
    centres = (np.arange(15) - 7) * WIDTH
    rng = np.random.default_rng(5)
    size = drift * np.sqrt(np.maximum(NEAREST - centres, 0.0))
    errors = slope * size * rng.standard_normal((2000, 15))
    return Errors(errors, np.tile(slope * centres, (2000, 1)), WIDTH)


def test_the_process_on_level_ground_is_found_again() -> None:
    found = fit([level(0.006, 0.25)])
    assert found.height == pytest.approx(0.006, rel=0.05)
    assert found.length == pytest.approx(0.25, rel=0.15)
    assert found.drift == 0.0


def test_the_drift_is_found_again_from_slopes() -> None:
    exact = level(1e-9, 0.25)
    found = fit([sloped(0.05, 0.5), exact])
    assert found.drift == pytest.approx(0.05, rel=0.05)
    # Twice the drift makes four times the excess, of which the factor on the drift is the half.
    twice = [sloped(0.1, 0.5), exact]
    assert scale([sloped(0.05, 0.5), exact], twice) == pytest.approx(0.5, rel=0.05)


def test_ground_without_slopes_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_errors, "_record", lambda words, seed: [level(0.006, 0.25)])
    with pytest.raises(RequestError, match="--terrain flat: no sloped ground is on it"):
        map_errors.main(["--terrain", "flat"])


def test_ground_that_was_not_seen_does_not_count() -> None:
    error = np.array([[1.0, np.nan, 2.0, 4.0], [1.0, 7.0, np.nan, 4.0]])
    assert correlation_along([error], 3) == 1.0  # (1, 4) twice: proportional
    assert correlation_in_time([error[:, [0, 1, 2, 3]]], 1) == 1.0  # (1, 1) and (4, 4)


def test_errors_that_change_with_each_decision_become_jitter() -> None:
    rng = np.random.default_rng(6)
    place = np.tile(0.5 * WIDTH * (np.arange(15) - 7), (4000, 1))
    stays = np.repeat(rng.standard_normal((40, 15)), 100, axis=0)
    kept = Errors(0.02 * 0.5 * stays, place, WIDTH)
    both = Errors(kept.error + 0.02 * 0.5 * rng.standard_normal((4000, 1)), place, WIDTH)
    exact = level(1e-9, 0.25)
    found = with_jitter(MapErrorSize(0.0, 1.0, 0.05), [both, exact], [kept, exact])
    assert found.jitter == pytest.approx(0.02, rel=0.1)
    assert found.drift == pytest.approx(0.05, rel=0.1)  # half of twice the variance
