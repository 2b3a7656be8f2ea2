"""Engines and sensors, which use no rewards; each engine has its own folder."""
