"""Named sets of reward terms: ``rewards=<name>``."""
