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

from playwright.sync_api import expect

from benchmarks.browser import chromium
from benchmarks.drive import served

WATCHED = "watch", "generalist", "level", "terrain=pallet", "sim=mujoco", "--speed", "0.3"


def main() -> None:
    """Take a picture of each page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("docs/images"))
    output = parser.parse_args().output.resolve()
    with served(*WATCHED) as (address, _), chromium() as browser:
        tab = browser.new_page(viewport={"width": 1280, "height": 800})
        tab.goto(address)
        time = tab.locator("#lane-0 [data-value=time]")
        expect(time).to_have_text(re.compile(r"^[6-8]\.\d$"), timeout=120_000)
        tab.keyboard.press("p")
        tab.wait_for_timeout(10_000)  # the scene is drawn sharply once it stands still
        tab.screenshot(path=output / "watch.png", timeout=120_000)
    with tempfile.TemporaryDirectory() as folder:
        words = "--scene", "stair", "--perception", "planar", "--folder", folder, "--picture"
        command = [sys.executable, "-m", "benchmarks.drive", *words, str(output / "drive.png")]
        subprocess.run(command, check=True)  # noqa: S603


if __name__ == "__main__":
    main()
