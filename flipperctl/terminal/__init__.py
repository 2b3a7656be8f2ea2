"""The output of commands: tables, progress, notices and follow-up commands."""
