"""Readers of recorded ground; they depend on no terrain plugin and use no randomness."""
