"""Readers for recorded ground; they know no terrain plugin and use no randomness."""
