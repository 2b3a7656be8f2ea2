"""Open the study of a search, which several searches may share.

In: the settings and overrides of the search. Out: Optuna's study, new or as earlier searches left
it.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

from flipperctl.errors import ConfigError
from flipperctl.runs.search import SearchSettings
from flipperctl.runs.trials import finished

if TYPE_CHECKING:
    from optuna import Study

_PAUSE = 1.0
"""Time to wait for another search that is creating the tables of the storage [s]."""
_MEASURE, _AT_100_HZ = "measure", "pitch_variation_100hz"
"""Attribute of a study that names the θ̂_R in its objective; earlier versions wrote none."""


def open_study(settings: SearchSettings, arguments: Sequence[str]) -> Study:
    """Return the study of ``settings``, new or as earlier searches left it.

    Raises:
        ConfigError: the storage cannot be used, or the study has other overrides than
            ``arguments`` or another objective.
    """
    import optuna
    from sqlalchemy.exc import SQLAlchemyError

    name, storage = settings.study_name, settings.storage
    create = partial(
        optuna.create_study,
        storage=storage,
        study_name=name,
        direction="maximize",
        load_if_exists=True,
    )
    with usable(storage, ImportError, ValueError):  # of its driver and of its URL
        try:
            study = create()
        except SQLAlchemyError:  # another search may be creating the tables
            time.sleep(_PAUSE)
            study = create()
    with usable(storage):
        _take_up(study, settings, sorted(arguments))
    return study


@contextlib.contextmanager
def usable(storage: str | None, *more: type[Exception]) -> Iterator[None]:
    """Turn errors of a study's storage, and ``more``, into a ConfigError that names it."""
    from optuna.exceptions import StorageInternalError
    from sqlalchemy.exc import SQLAlchemyError

    errors: tuple[type[Exception], ...] = (StorageInternalError, SQLAlchemyError, *more)
    try:
        yield
    except errors as error:
        cause = error.__cause__ if isinstance(error, StorageInternalError) else None
        reason = " ".join(str(cause or error).split("\n(Background")[0].split())
        raise ConfigError(
            f"hydra.sweeper.storage: {storage!r} cannot be used: {reason}; "
            "a database URL is allowed, as in sqlite:///search.db"
        ) from error


def _take_up(study: Study, settings: SearchSettings, asked: list[str]) -> None:
    """Check that a study searched the same, and note what it searches.

    Raises:
        ConfigError: see ``open_study``.
    """
    name, storage = settings.study_name, settings.storage
    searched = study.user_attrs.get("overrides", asked)
    if searched != asked:
        raise ConfigError(
            f"hydra.sweeper.study_name: the study {name!r} in {storage} searched "
            f"{' '.join(searched)}; give the same overrides, or another study_name"
        )
    if study.user_attrs.get(_MEASURE) != _AT_100_HZ and finished(study):
        raise ConfigError(
            f"hydra.sweeper.study_name: the trials of the study {name!r} in {storage} are "
            "ordered by θ̂_R at decisions, as in earlier versions, and cannot be compared with "
            "new ones, which are ordered by θ̂_R at 100 Hz; give another study_name"
        )
    study.set_user_attr("overrides", asked)
    study.set_user_attr(_MEASURE, _AT_100_HZ)
