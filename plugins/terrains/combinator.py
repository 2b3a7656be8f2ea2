"""Base class of terrains that are composed of other terrains."""

from typing import Self

from flipperctl.api import Terrain


class Combinator(Terrain):
    """Pass its difficulty on to each of the terrains in its fields."""

    def _inner(self) -> dict[str, Terrain | tuple[Terrain, ...]]:
        values = {name: getattr(self, name) for name in type(self).model_fields}
        return {
            name: value
            for name, value in values.items()
            if isinstance(value, Terrain)
            or (isinstance(value, tuple) and any(isinstance(item, Terrain) for item in value))
        }

    def _terrains(self) -> list[Terrain]:
        groups = self._inner().values()
        return [t for group in groups for t in (group if isinstance(group, tuple) else (group,))]

    @property
    def first_difficulty(self) -> float:
        """Smallest first difficulty of the inner terrains [-]."""
        return min(part.first_difficulty for part in self._terrains())

    def next_difficulty(self, difficulty: float, reached: bool) -> float:
        """Return the next difficulty of the first inner terrain that changes it."""
        following = [part.next_difficulty(difficulty, reached) for part in self._terrains()]
        return next((value for value in following if value != difficulty), difficulty)

    def at(self, difficulty: float) -> Self:
        """Return this terrain with every inner terrain configured for ``difficulty``."""
        inner = {
            name: tuple(part.at(difficulty) for part in value)
            if isinstance(value, tuple)
            else value.at(difficulty)
            for name, value in self._inner().items()
        }
        return self.model_copy(update=inner)
