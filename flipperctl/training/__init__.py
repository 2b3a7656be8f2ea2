"""A training run: the loop, validation, what it records."""
