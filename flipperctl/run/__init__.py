"""Runs: training, evaluation, export, and the files they leave."""
