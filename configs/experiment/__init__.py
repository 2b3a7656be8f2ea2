"""Named experiments: ``experiment=<name>``."""
