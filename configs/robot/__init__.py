"""Robots by name: ``robot=<name>``."""
