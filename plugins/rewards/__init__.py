"""Built-in reward terms: the paper's three, and further ones to compose rewards from."""

from . import contact, motion, paper

__all__ = ["contact", "motion", "paper"]
