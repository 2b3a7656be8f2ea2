"""What readers of files write to stderr or warn of, turned into errors or left out.

In: code that reads a file. Out: its errors alone.
"""

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quiet() -> Iterator[None]:
    """Make readers report faults as errors: raise their warnings and silence their logs.

    A logger with a handler of its own does not write to stderr.
    """
    for name in ("rasterio", "trimesh"):
        logger = logging.getLogger(name)
        if not logger.handlers:
            logger.addHandler(logging.NullHandler())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", PendingDeprecationWarning)  # addressed to libraries
        yield
