"""Evaluation of policies on scenes: episodes, conditions, statistics and files."""
