"""How much memory is left, and a refusal of what would not fit, before it is taken.

Linux hands out more memory than there is and ends the process when it is used; so the sizes that
a configuration asks for are compared with what is free first.
"""

from __future__ import annotations

from pathlib import Path

from flipperctl.errors import ConfigError

_CGROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)
"""Limit and use of a container, versions 2 and 1 [B]."""


def available() -> int | None:
    """Memory that this process may still take [B]; None where the system does not say."""
    found = [*_of_the_machine(), *_of_the_container(), *_of_the_process()]
    return max(0, min(found)) if found else None


def require(size: int, what: str, advice: str) -> None:
    """Compare a size [B] with what is free.

    Raises:
        ConfigError: it does not fit. ``what`` names it, ``advice`` says what to change.
    """
    free = available()
    if free is not None and size > free:
        raise ConfigError(
            f"{what} {gigabytes(size)} of memory, but {gigabytes(free)} are free; {advice}"
        )


def gigabytes(size: int) -> str:
    """A size as people read it."""
    return f"{size / 1e9:,.1f} GB" if size < 1e15 else f"{size / 1e9:.1e} GB"


def _of_the_machine() -> list[int]:
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return []
    return [1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")]


def _of_the_container() -> list[int]:
    found = []
    for limit, used in _CGROUPS:
        try:
            found.append(int(Path(limit).read_text()) - int(Path(used).read_text()))
        except (OSError, ValueError):  # no such group, or "max": it has no limit
            continue
    return found


def _of_the_process() -> list[int]:
    try:
        import resource
    except ImportError:  # Windows has none
        return []
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return []
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except (OSError, ValueError):
        return []
    return [limit - pages * resource.getpagesize()]
