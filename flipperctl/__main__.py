"""``python -m flipperctl`` and the command ``flipperctl``."""

from __future__ import annotations

from flipperctl.process import entry


def main() -> None:
    """Run the command line; without the packages that it needs, say so."""
    entry.run(_main)


def _main() -> int:
    try:
        from flipperctl.cli.main import run  # inside, so that Ctrl-C meanwhile is one line
    except ModuleNotFoundError as error:
        missing = (error.name or "flipperctl").partition(".")[0]
        if missing == "flipperctl":
            raise  # an error of flipperctl, not of the installation
        from flipperctl.errors import RequestError

        raise RequestError(
            f"the package {missing} is missing: this installation has only "
            "flipperctl.runtime; install flipperctl with its dependencies for the command line"
        ) from error
    return run()


if __name__ == "__main__":
    main()
