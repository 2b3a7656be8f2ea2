"""What commands print: tables, progress, notices, and the commands to run next."""
