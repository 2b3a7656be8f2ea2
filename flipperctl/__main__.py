"""``python -m flipperctl`` and the command ``flipperctl``."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line; without the packages that it needs, say so."""
    try:
        from flipperctl.cli.main import main as run
    except ModuleNotFoundError as error:
        if (error.name or "flipperctl").partition(".")[0] == "flipperctl":
            raise  # an error of flipperctl, not of the installation
        print(
            f"error: the package {error.name} is missing: this installation has only "
            "flipperctl.runtime; install flipperctl with its dependencies for the command line",
            file=sys.stderr,
        )
        sys.exit(2)
    run()


if __name__ == "__main__":
    main()
