"""Rows as data frames of pandas, which is an optional package."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from flipperctl.errors import MissingExtraError

if TYPE_CHECKING:
    from pandas import DataFrame


def data_frame(rows: Iterable[Mapping[str, object]]) -> DataFrame:
    """Return a data frame with a row for each mapping; a column that a row lacks is empty there.

    Raises:
        MissingExtraError: pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise MissingExtraError(
            "data frames need pandas: pip install 'flipperctl[frames]'"
        ) from error
    return pandas.DataFrame(list(rows))
