"""The command line: one small file per subcommand; heavy imports happen inside the command."""
