"""A lifecycle node around ``flipperctl.runtime``."""
