"""Developers' benchmarks, run in a clone; each is a module with ``ABOUT`` and ``measure``."""
