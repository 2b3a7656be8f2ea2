"""A training run: loop, episodes, validation, checkpoints and records."""
