"""A training run: the loop, its episodes, validation, checkpoints and records."""
