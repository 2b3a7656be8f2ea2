"""Files of Hydra's configuration, such as those of ``--config-dir``, read by our strict reader.

In: Hydra's registry of sources, whose own read YAML 1.1. Out: the same with ours in their place, as
long as a command composes; what another application of Hydra in this process reads stays Hydra's.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from hydra._internal.core_plugins.file_config_source import FileConfigSource
from hydra._internal.core_plugins.importlib_resources_config_source import (
    ImportlibResourcesConfigSource,
)
from hydra._internal.sources_registry import SourcesRegistry
from hydra.plugins.config_source import ConfigLoadError, ConfigResult, ConfigSource
from omegaconf import OmegaConf

from flipperctl.config import strict_yaml
from flipperctl.errors import ConfigError

_HEADER = 512
"""Length of the text in which Hydra looks for ``# @package`` [characters]."""


@contextlib.contextmanager
def strict_files() -> Iterator[None]:
    """Let Hydra read the files of its configuration with ours while the body composes."""
    resolve = SourcesRegistry.resolve

    def resolve_strictly(self: SourcesRegistry, scheme: str) -> type[ConfigSource]:
        ours = {source.scheme(): source for source in (_Files, _Packages)}
        return ours.get(scheme) or resolve(self, scheme)

    # Not registered in their place, since launchers hand the registry to their processes.
    SourcesRegistry.resolve = resolve_strictly  # type: ignore[method-assign]  # for a while
    try:
        yield
    finally:
        SourcesRegistry.resolve = resolve  # type: ignore[method-assign]  # Hydra's own


class _Files(FileConfigSource):
    def load_config(self, config_path: str) -> ConfigResult:
        return _read(self, Path(self.path), config_path)


class _Packages(ImportlibResourcesConfigSource):
    def load_config(self, config_path: str) -> ConfigResult:
        return _read(self, resources.files(self.path), config_path)


def _read(source: ConfigSource, folder: Traversable, name: str) -> ConfigResult:
    file = folder.joinpath(source._normalize_file_name(name))
    if not file.is_file():
        raise ConfigLoadError(f"Config not found : {file}")
    text = strict_yaml.read_text(file, str(file))
    found = strict_yaml.parse(text, str(file))
    if not isinstance(found, dict | None):
        raise ConfigError(f"{file}: a mapping is allowed; it holds {found!r:.60}")
    try:
        header = source._get_header_dict(text[:_HEADER])
    except ValueError as error:
        raise ConfigError(f"{file}: {error}") from error
    return ConfigResult(source.provider, source.full_path(), OmegaConf.create(found or {}), header)
