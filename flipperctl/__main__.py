"""``python -m flipperctl`` and the command ``flipperctl``."""

from __future__ import annotations

from flipperctl import entry


def main() -> None:
    """Run the command line; without the packages that it needs, say so."""
    entry.stop_at_once()
    try:
        from flipperctl.cli.main import main as run
    except ModuleNotFoundError as error:
        missing = (error.name or "flipperctl").partition(".")[0]
        if missing == "flipperctl":
            raise  # an error of flipperctl, not of the installation
        entry.run(lambda: _refuse(missing))
    run()


def _refuse(missing: str) -> int:
    from flipperctl.errors import RequestError

    raise RequestError(
        f"the package {missing} is missing: this installation has only "
        "flipperctl.runtime; install flipperctl with its dependencies for the command line"
    )


if __name__ == "__main__":
    main()
