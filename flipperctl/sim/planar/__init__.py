"""The planar engine: pymunk, belts, the compiled loop, sensing in the side plane."""
