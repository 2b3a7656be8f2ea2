"""Turn the warnings of file readers into errors and silence their logs.

In: code that reads a file. Out: only its errors.
"""

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quiet() -> Iterator[None]:
    """Raise the warnings of readers as errors and silence their logs.

    A logger that has a handler does not write to stderr.
    """
    for name in ("rasterio", "trimesh"):
        logger = logging.getLogger(name)
        if not logger.handlers:
            logger.addHandler(logging.NullHandler())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", PendingDeprecationWarning)  # addressed to libraries
        yield
