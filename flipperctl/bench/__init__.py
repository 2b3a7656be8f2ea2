"""Benchmarks: each measure of ``flipperctl bench`` in a file of its own."""
