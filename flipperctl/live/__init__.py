"""Watching policies in a browser or a terminal while they drive."""
