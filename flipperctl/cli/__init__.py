"""The command line: one small file a subcommand; heavy imports happen inside the command."""
