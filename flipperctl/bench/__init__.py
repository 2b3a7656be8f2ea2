"""Measures of ``flipperctl bench``; each is a module with ``ABOUT`` and ``measure``."""
