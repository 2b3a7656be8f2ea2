"""flipperctl: train, evaluate, export and explain flipper policies of tracked rescue robots."""

__version__: str


def __getattr__(name: str) -> str:
    """``__version__``, read when it is asked for: the package metadata cost 20 ms at import."""
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import PackageNotFoundError, version

    try:
        found = version("flipperctl")
    except PackageNotFoundError:  # a source tree that was never installed
        found = "0.0.0"
    globals()["__version__"] = found
    return found
