"""Figures for people: drawn terrain, learning curves, one episode. Imports matplotlib."""
