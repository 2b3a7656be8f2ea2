"""Episodes: the one loop that plays them, and who plays them for a training."""
