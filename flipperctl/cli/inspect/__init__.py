"""``flipperctl inspect``: views of plugins, terrains, rewards, files, runs and settings."""

HELP = "Look at plugins, terrains, rewards, files, runs and settings."
VIEWS = ("plugins", "terrain", "reward", "checkpoint", "run", "config")
"""Modules beside this one, each with a subcommand; help lists them in this order."""
