"""Policies of every kind, and trained ones: ``<name>.safetensors`` with its card ``<name>.md``."""
