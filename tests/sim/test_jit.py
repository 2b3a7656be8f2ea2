"""Numba's cache where nothing can be written."""

import logging
import tempfile
from pathlib import Path
from typing import Any

import numba
import pytest
from numba.core import caching

from flipperctl.sim import jit


def add(a: int, b: int) -> int:
    return a + b


@pytest.fixture
def sealed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Leave numba without a writable folder other than the temporary one."""
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [caching.UserProvidedCacheLocator])
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_the_cache_falls_back_to_the_temporary_folder(
    sealed: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(RuntimeError, match="no locator available"):
        numba.njit(cache=True)(add)
    with caplog.at_level(logging.DEBUG, "flipperctl"):
        functions = [jit.cached(numba.njit)(add) for _ in range(2)]
    assert functions[0](1, 2) == 3
    assert list(sealed.glob("flipperctl-numba-*/*/*.nbi"))
    assert len(caplog.records) == 1
    assert str(sealed) in caplog.text


def test_without_any_folder_there_is_no_cache(
    sealed: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(sealed / "missing"))
    with caplog.at_level(logging.DEBUG, "flipperctl"):
        assert jit.cached(numba.njit)(add)(1, 2) == 3
    assert "no cache" in caplog.text


def test_a_folder_that_others_can_write_is_not_trusted(sealed: Path) -> None:
    folder = jit.private_folder()
    assert folder is not None
    folder.chmod(0o777)
    assert jit.private_folder() is None


def test_a_link_is_not_followed(sealed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder: Any = jit.private_folder()
    folder.rmdir()
    (sealed / "elsewhere").mkdir(mode=0o700)
    folder.symlink_to(sealed / "elsewhere")
    assert jit.private_folder() is None
