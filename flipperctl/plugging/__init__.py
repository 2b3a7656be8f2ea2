"""Finding plugins, and whose fault an error of one is."""
