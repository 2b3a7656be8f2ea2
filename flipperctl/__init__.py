"""flipperctl: train, judge, export and explain flipper policies of tracked rescue robots."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("flipperctl")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0.0.0"
