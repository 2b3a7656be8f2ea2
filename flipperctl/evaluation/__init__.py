"""Evaluation: episodes of any policy, their statistics, the audit of rewards."""
