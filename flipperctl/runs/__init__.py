"""The life of a run: its folder and lock, and sweeps and searches over runs."""
