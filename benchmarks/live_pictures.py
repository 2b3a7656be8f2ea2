"""Pictures of the live pages for the documentation, taken from a headless Chromium.

python -m benchmarks.live_pictures [--output docs/images]
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.browser import chromium
from benchmarks.drive import dismiss, served

WATCHED = "watch", "generalist", "level", "terrain=pallet", "sim=mujoco"


def main() -> None:
    """Take a picture of each page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("docs/images"))
    output = parser.parse_args().output.resolve()
    with served(*WATCHED) as (address, _), chromium() as browser:
        tab = browser.new_page(viewport={"width": 1280, "height": 800})
        tab.goto(address)
        tab.get_by_text(re.compile(r"time [6-8]\.\d s")).first.wait_for(timeout=60_000)
        tab.keyboard.press("p")
        dismiss(tab)
        tab.wait_for_timeout(2_000)
        tab.screenshot(path=output / "watch.png")
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "benchmarks.drive", "--scene", "stair", "--folder", folder]
        subprocess.run([*command, "--picture", str(output / "drive.png")], check=True)  # noqa: S603


if __name__ == "__main__":
    main()
