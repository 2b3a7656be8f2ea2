"""Engines and sensors; knows no reward."""
