"""The type of a setting whose value is sampled from a range."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

_ALLOWED = "a range [low, high] with low ≤ high, or one number, is allowed"


class _Ends(NamedTuple):
    low: float
    high: float


class Range(_Ends):
    """The numbers from ``low`` to ``high``, in the unit of the setting, whose value they are.

    Users write ``[low, high]``, or one number, which is both ends. A range is less or greater than
    a number if all of it is, so that the bounds of a field hold for both ends::

        height: Range = Field(Range(0.1, 0.3), gt=0, le=0.8, description="height of a hurdle [m]")
    """

    __slots__ = ()
    _number: ClassVar[Callable[[], CoreSchema]] = core_schema.float_schema

    def sample(self, rng: np.random.Generator) -> float:
        """Return a number from the range; all are equally probable."""
        return float(rng.uniform(self.low, self.high))

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of two numbers, the smaller first, or of one."""
        ends = core_schema.tuple_schema([cls._number(), cls._number()])
        pair = core_schema.no_info_before_validator_function(_both_ends, ends)
        return core_schema.no_info_after_validator_function(cls._ordered, pair)

    @classmethod
    def _ordered(cls, ends: tuple[float, float]) -> Self:
        if ends[0] > ends[1]:
            raise ValueError(_ALLOWED)
        return cls(*ends)

    # pydantic compares a value with the bounds of its field: all of a range must lie within.
    def __lt__(self, other: Any) -> bool:
        return self.high < other if isinstance(other, int | float) else super().__lt__(other)

    def __le__(self, other: Any) -> bool:
        return self.high <= other if isinstance(other, int | float) else super().__le__(other)

    def __gt__(self, other: Any) -> bool:
        return self.low > other if isinstance(other, int | float) else super().__gt__(other)

    def __ge__(self, other: Any) -> bool:
        return self.low >= other if isinstance(other, int | float) else super().__ge__(other)


class IntRange(Range):
    """The integers from ``low`` to ``high``, both included."""

    __slots__ = ()
    _number = core_schema.int_schema

    def sample(self, rng: np.random.Generator) -> int:
        """Return an integer from the range; all are equally probable."""
        return int(rng.integers(int(self.low), int(self.high) + 1))


def _both_ends(value: object) -> object:
    """Return both ends of a range that is given as a list or as one number.

    Raises:
        ValueError: it is given otherwise.
    """
    if isinstance(value, int | float) and not isinstance(value, bool):
        return (value, value)
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ValueError(_ALLOWED)
    return value
