"""How a program of the package begins, is interrupted and ends."""
