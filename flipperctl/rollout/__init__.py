"""Rollouts: the one episode loop, and the collectors and workers that run it in training."""
