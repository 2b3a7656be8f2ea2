"""Hydra's configuration files, shipped with the package."""
