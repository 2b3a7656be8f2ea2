"""Scripts that drive the page of ``flipperctl drive`` in a browser, and what it measures.

    python -m benchmarks.drive [--scene step|stair] [--sim planar|mujoco] [--by keys|buttons]
    python -m benchmarks.drive --study study.yaml --as fixed

It opens the page in a headless Chromium of this machine and drives it by keys or by the buttons
alone, after a fixed plan with a reaction time and with waiting, as people do; it presses nothing
that a person could not press, and its drives are labelled as those of a script. It prints how each
drive ended, the rate of commands, and the time from a key to the motion that the page shows.
"""

from __future__ import annotations

import argparse
import re
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.browser import chromium

SCENES = {
    "step": (("terrain=step", "terrain.height=0.4"), 1.0),
    "stair": (("terrain=paper_stair",), 5.5),
}
"""Words of each scene, and its finish [m]."""


class Way(NamedTuple):
    """From this place on the flippers shall have these angles."""

    x: float
    """World x of the chassis centre [m]."""
    front: int
    """Target of the front flippers [steps]."""
    rear: int
    """Target of the rear flippers [steps]."""


PLANS = {
    "step": (
        *(Way(-2.0, 2, 0), Way(-0.70, 3, 0), Way(-0.61, 1, -2), Way(-0.57, 0, -3)),
        *(Way(-0.43, -1, -4), Way(-0.05, -1, -3), Way(0.07, -1, -2), Way(0.21, -1, 0)),
    ),
    "stair": (
        *(Way(-2.0, 1, 0), Way(-0.80, 2, 0), Way(-0.66, 3, 0), Way(-0.54, 2, -1)),
        *(Way(-0.25, 1, -2), Way(0.08, 1, -1), Way(0.21, 0, -1), Way(0.29, 0, 0)),
        *(Way(1.10, -1, 0), Way(1.20, -2, 0), Way(1.30, -3, -1), Way(1.42, -4, -1)),
        *(Way(1.53, -4, 0), Way(1.65, -4, 1), Way(1.90, -3, 2), Way(2.38, -2, 1)),
        *(Way(3.15, -3, 1), Way(3.40, -4, 1), Way(3.65, -3, 1), Way(3.73, -2, 1)),
        *(Way(3.79, -1, 1), Way(3.91, -1, 0), Way(4.30, 0, 1), Way(4.36, 1, 1)),
        *(Way(4.44, 2, 0), Way(4.60, 2, -1), Way(4.76, 1, -2), Way(5.40, 1, -1)),
    ),
}
"""Plans of the two scenes; the turns of the shipped policy on them, in the order of its places."""
STEP = 0.2618
"""Turn of one press [rad]."""


class ScriptedOperator:
    """Drives one episode by a plan, through the page alone."""

    def __init__(
        self, tab: Any, plan: Sequence[Way], finish: float, *, keys: bool, reaction: float
    ) -> None:
        """``keys``: by keys, else by the buttons; ``reaction``: time before it acts [s]."""
        self.tab, self.plan, self.keys, self.reaction = tab, plan, keys, reaction
        self._finish = finish
        self.latencies: list[float] = []
        self._driving = False

    def value(self, name: str) -> float:
        """Return what a gauge shows, in SI units."""
        return float(self.tab.locator(f"#{name}").get_attribute("data-value") or 0.0)

    def _forward(self, on: bool) -> None:
        if on == self._driving:
            return
        self._driving = on
        if self.keys:
            (self.tab.keyboard.down if on else self.tab.keyboard.up)("ArrowUp")
        elif on:
            box = self.tab.locator("#forward").bounding_box()
            self.tab.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
            self.tab.mouse.down()
        else:
            self.tab.mouse.up()

    def _press(self, pair: str, up: bool) -> None:
        if self.keys:
            self.tab.keyboard.press({"front": "qa", "rear": "ed"}[pair][0 if up else 1])
            return
        moving = self._driving
        self._forward(False)  # a mouse has one pointer
        self.tab.locator(f"#{pair}-{'up' if up else 'down'}").click()
        self._forward(moving)

    def drive(self, limit: float = 240.0, picture: Path | None = None) -> str:
        """Drive from the start to the end of an episode; return how it ended.

        ``picture``: file for a picture of the page, a sixth of the way, where the drive is left.
        """
        tab = self.tab
        if picture is not None:
            tab.locator("#speed").fill("25")  # a busy machine draws and hears too late for more
        tab.locator("#begin").click() if not self.keys else tab.keyboard.press("Enter")
        begun, at = time.monotonic(), 0
        while time.monotonic() - begun < limit:
            phase = tab.locator("#phase").get_attribute("data-value")
            if phase == "over":
                self._forward(False)
                return str(tab.locator("#phase").get_attribute("data-outcome"))
            x = self._finish - self.value("left")
            while at + 1 < len(self.plan) and self.plan[at + 1].x <= x:
                at += 1  # and never back, where the robot slides
            way = self.plan[at]
            if picture is not None and at > len(self.plan) // 6:
                self._forward(False)
                tab.locator("#speed").blur()
                tab.evaluate("sceneMoves = () => $('scene').classList.remove('coarse')")
                tab.wait_for_timeout(10_000)
                tab.screenshot(path=picture, timeout=120_000)
                return "pictured"
            wanted = {"front": way.front, "rear": way.rear}
            if latency := self.value("latency"):
                self.latencies.append(latency)
            # It stands while a flipper is more than a step away from where it shall be.
            self._forward(all(abs(self.value(n) - STEP * wanted[n]) < 1.5 * STEP for n in wanted))
            targets = tab.evaluate("state.targets")  # its dashed lines
            steps = {n: round(t / STEP) for n, t in zip(wanted, targets, strict=True)}
            due = [n for n in wanted if steps[n] != wanted[n]]
            if not due:
                tab.wait_for_timeout(50)
                continue
            tab.wait_for_timeout(1000 * self.reaction)
            for name in due:
                self._press(name, wanted[name] > steps[name])
            tab.wait_for_timeout(400)  # until a flipper has turned most of a step
        self._forward(False)
        return "given up"


@contextmanager
def served(*command: str, folder: Path = Path()) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Run a command of flipperctl that serves a page; yield the page's address."""
    whole = [sys.executable, "-m", "flipperctl", *command, "--no-open", "--port", "0"]
    run = subprocess.Popen(whole, cwd=folder, stderr=subprocess.PIPE, text=True)  # noqa: S603
    assert run.stderr is not None
    address = ""
    for line in run.stderr:
        print(line, end="", file=sys.stderr)
        if found := re.search(r"http://\S+", line):
            address = found[0]
            break
    printing = threading.Thread(target=_pass_on, args=(run.stderr,), daemon=True)
    printing.start()
    try:
        yield address, run
    finally:
        run.kill()
        printing.join(5)


def _pass_on(lines: Any) -> None:
    for line in lines:
        print(line, end="", file=sys.stderr)


def drive_all(tab: Any, run: subprocess.Popen[str], given: argparse.Namespace) -> None:
    """Drive each episode that the page offers, answer its questions, and print what came."""
    while run.poll() is None:
        tab.wait_for_timeout(200)
        if tab.locator("#asking").evaluate("form => form.open"):
            for slider in tab.locator("#questions input").all():
                slider.fill("50")  # a script has no opinion
            tab.locator("#answer").click()
            continue
        if tab.locator("#phase").get_attribute("data-value") != "ready":
            continue
        title = tab.locator("#title").get_attribute("data-value") or ""
        scene = next(name for name in PLANS if name in title)
        operator = ScriptedOperator(
            *(tab, PLANS[scene], SCENES[scene][1]), keys=given.by == "keys", reaction=given.reaction
        )
        outcome = operator.drive(picture=given.picture)
        print(
            f"{title}, {given.by}: {outcome} after {operator.value('time'):.1f} s, pitch variation "
            f"{operator.value('variation'):.2f} rad; key to motion "
            f"{1000 * statistics.median(operator.latencies):.0f} ms (median), "
            f"{operator.value('rate'):.1f} commands a second"
        )
        if given.picture is not None:
            return
        tab.locator("#begin").click()
        tab.wait_for_timeout(1000)


def main() -> None:
    """Drive, and print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", choices=PLANS, default="step")
    parser.add_argument("--sim", choices=("planar", "mujoco"), default="mujoco")
    parser.add_argument("--by", choices=("keys", "buttons"), default="keys")
    parser.add_argument("--perception", default="lidar")
    parser.add_argument("--study", help="a study whose scenes are called step or stair")
    parser.add_argument("--as", dest="name", default="fixed")
    parser.add_argument("--episodes", type=int, default=1)
    parser.add_argument("--reaction", type=float, default=0.2, help="[s]")
    parser.add_argument("--folder", type=Path, default=Path())
    parser.add_argument("--picture", type=Path, help="a picture of the page, in the first half")
    given = parser.parse_args()
    words = [*SCENES[given.scene][0], f"sim={given.sim}", f"perception={given.perception}"]
    words += ["--episodes", str(given.episodes)]
    if given.study:
        words = ["--study", given.study]
    command = ["drive", *words, "--as", given.name, "--script"]
    with served(*command, folder=given.folder) as (address, run), chromium() as browser:
        tab = browser.new_page(viewport={"width": 1280, "height": 800})
        tab.goto(address)
        drive_all(tab, run, given)


if __name__ == "__main__":
    main()
