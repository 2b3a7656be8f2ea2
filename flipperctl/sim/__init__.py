"""Engines and sensors, which know no reward; each engine is a folder of its own."""
