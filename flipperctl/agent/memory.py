"""Free memory, and a check that a size fits into it before it is allocated.

Linux grants more memory than exists and kills the process that uses it. The sizes that a
configuration asks for are therefore compared with the free memory first.
"""

from __future__ import annotations

from pathlib import Path

from flipperctl.errors import ConfigError

_CGROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)
"""Files with the limit and the use of a container's memory, versions 2 and 1 of cgroups [B]."""


def available() -> int | None:
    """Return the memory that this process may still allocate [B]; None if unknown."""
    found = [*_free_in_machine(), *_free_in_container(), *_free_in_process()]
    return max(0, min(found)) if found else None


def require(size: int, what: str, advice: str) -> None:
    """Check that ``size`` [B] fits into the free memory.

    The error reads ``what``, then the needed and the free memory, then ``advice``.

    Raises:
        ConfigError: the size does not fit.
    """
    free = available()
    if free is not None and size > free:
        raise ConfigError(
            f"{what} {gigabytes(size)} of memory, but {gigabytes(free)} are free; {advice}"
        )


def gigabytes(size: int) -> str:
    """Return a size [B] as text in gigabytes."""
    return f"{size / 1e9:,.1f} GB" if size < 1e15 else f"{size / 1e9:.1e} GB"


def _free_in_machine() -> list[int]:
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return []
    return [1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")]


def _free_in_container() -> list[int]:
    found = []
    for limit, used in _CGROUPS:
        try:
            found.append(int(Path(limit).read_text()) - int(Path(used).read_text()))
        except (OSError, ValueError):  # no such group, or the limit is "max"
            continue
    return found


def _free_in_process() -> list[int]:
    try:
        import resource
    except ImportError:  # Windows has no such module
        return []
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return []
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except (OSError, ValueError):
        return []
    return [limit - pages * resource.getpagesize()]
