"""Subcommands of flipperctl that are plugins, as a stranger's are: entry points name them."""
