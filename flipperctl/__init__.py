"""flipperctl: train, evaluate, export and explain flipper policies of tracked rescue robots.

``train``, ``evaluate`` and the others are the Python interface, for scripts and notebooks.
They are imported when one of them is first used.
"""

# Type checkers read __init__.pyi, which says where the names come from.

__all__ = [
    "Evaluation",
    "LoadedPolicy",
    "Run",
    "environment",
    "evaluate",
    "load",
    "plot",
    "save",
    "train",
]


def __getattr__(name: str) -> object:
    """Return a name of the interface or ``__version__``, found when it is first asked for."""
    if name in __all__:
        from importlib import import_module

        from flipperctl.process.undisturbed import undisturbed

        with undisturbed():  # libraries draw random numbers when they are imported
            value: object = getattr(import_module("flipperctl.scripting"), name)
    elif name == "__version__":
        value = _version()
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version  # 20 ms

    try:
        return version("flipperctl")
    except PackageNotFoundError:  # a source tree that was never installed
        return "0.0.0"
