"""Trained policies that come with the package: ``<name>.safetensors``, each with its card."""
