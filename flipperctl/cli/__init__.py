"""The command line: a function for each subcommand; heavy imports happen inside it."""
