"""Observation, action, reward sum and ends: the task as a Gymnasium environment."""
