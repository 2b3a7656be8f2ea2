"""Named conditions of driving: ``conditions=<name>``."""
