"""Life of a run: its folder, who holds it, sweeps and searches over runs."""
