"""Natural rough ground, by the power law of its spectrum."""

import math
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import FloatArray, Profile, Range, Terrain, terrain

_REFERENCE = 0.1
"""Wavenumber at which the roughness is stated, as in ISO 8608 [cycles/m]."""
_PER_OCTAVE = 8
"""Number of cosines for each doubling of the wavenumber [-]."""
_CHORDS = 6
"""Number of chords of the shortest wave [-]."""


@terrain("rough")
class Rough(Terrain):
    """Ground whose height has the power spectral density G(n) = G(0.1) · (n / 0.1)^−w.

    n is the wavenumber in cycles/m. ISO 8608 describes roads so, with w = 2. Each of its classes is
    four times as rough as the one before. G(0.1) is 1,024 · 10⁻⁶ m³ in the middle of class D,
    16,384 in F, 65,536 in G and 262,144 in H, the last. Natural surfaces are self-affine, which is
    the same law with w = 1 + 2 · Hurst exponent (Sayles and Thomas 1978; Shepard et al. 2001).
    The ground is a sum of cosines with random phases.
    """

    roughness: Range = Field(
        Range(16384.0, 262144.0), gt=0, le=2e6, description="G(0.1), drawn log-uniformly [10⁻⁶ m³]"
    )
    exponent: Range = Field(Range(1.8, 2.6), ge=1, le=4, description="w [-]")
    length: Range = Field(Range(3.0, 6.0), gt=0.1, le=40, description="length of the ground [m]")
    longest: float = Field(4.0, gt=0.1, le=100, description="longest wave [m]")
    shortest: float = Field(
        0.15, ge=0.05, le=10, description="shortest wave; tracks hardly feel shorter ones [m]"
    )

    @model_validator(mode="after")
    def _has_waves(self) -> Self:
        if self.longest <= self.shortest:
            raise ValueError(
                f"longest ({self.longest:g} m) must exceed shortest ({self.shortest:g} m)"
            )
        return self

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return chords of the ground, which begins at height 0."""
        low, high = map(math.log, self.roughness)
        roughness = math.exp(rng.uniform(low, high))
        exponent = self.exponent.sample(rng)
        length = self.length.sample(rng)
        # Chords that are short enough for the shortest wave
        count = max(2, math.ceil(length / self.shortest * _CHORDS) + 1)
        x = np.linspace(0.0, length, count)
        waves, amplitudes = self.spectrum(roughness, exponent)
        # Random phases make another surface of the same spectrum.
        phases = rng.uniform(0.0, 2 * math.pi, len(waves))
        # Processors differ in the last digits of such a sum; they agree on nanometres.
        z = np.round(np.cos(2 * math.pi * np.outer(x, waves) + phases) @ amplitudes, 9)
        drawn = {"roughness": roughness, "exponent": exponent, "deviation": float(z.std())}
        return Profile(np.column_stack([x, z - z[0]]), drawn=drawn)

    def spectrum(self, roughness: float, exponent: float) -> tuple[FloatArray, FloatArray]:
        """Return wavenumbers [cycles/m] and amplitudes [m] of the cosines, each (W,).

        A cosine of amplitude a has the variance a²/2 of the spectrum's band around it.
        """
        # Bands of equal width in octaves, each with the variance of one cosine
        ends = 1 / self.longest, 1 / self.shortest
        bands = math.ceil(_PER_OCTAVE * math.log2(ends[1] / ends[0]))
        edges: FloatArray = np.geomspace(*ends, bands + 1)  # (W + 1,) [cycles/m]
        waves = np.sqrt(edges[1:] * edges[:-1])
        density = 1e-6 * roughness * (waves / _REFERENCE) ** -exponent  # [m³]
        amplitudes: FloatArray = np.sqrt(2 * density * np.diff(edges))
        return waves, amplitudes
