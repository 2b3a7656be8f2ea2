"""Probes of conventions, and sampled profiles."""
