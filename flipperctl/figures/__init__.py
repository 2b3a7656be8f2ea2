"""Figures of terrains, learning curves and episodes. Imports matplotlib."""
