"""The pymunk simulator: geometry, belts, the world and sensing. Knows no reward."""
