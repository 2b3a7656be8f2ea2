"""Versions of the benchmark: frozen scenes with fixed prices."""
