"""Benchmarks; each measure of ``flipperctl bench`` is a module with ``ABOUT`` and ``measure``."""
