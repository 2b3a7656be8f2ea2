"""Suites of scenes: ``suite=<name>`` of ``flipperctl eval``."""
