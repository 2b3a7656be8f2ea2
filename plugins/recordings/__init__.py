"""Readers for ground that was recorded; they speak of no terrain and draw nothing."""
