"""The report in a real browser without a window: what it shows, its player, light, dark, print."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks import browser as chromium
from flipperctl.requests.evaluation import episode_rows
from flipperctl.rollout.trace import FILE as TRACES
from flipperctl.rollout.trace import write as write_traces
from flipperctl.text.files import write_csv, write_json
from flipperctl.views import evaluation, report
from tests.cli.call import call
from tests.evaluation.samples import result, sample
from tests.figures.test_figures import trace

pytestmark = pytest.mark.skipif(chromium.installed() is None, reason="no Chromium is installed")


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of two policies on a step, of which one fails in its second episode."""
    folder = tmp_path_factory.mktemp("results")
    rows = [sample(i, "reached" if i != 1 else "overturned", 0.5 + 0.01 * i) for i in range(5)]
    level = [sample(i, "reached", 1.0 + 0.02 * i) for i in range(5)]
    both = result(rows, {"level": level})
    write_json(folder / "summary.json", evaluation.document(both))
    write_csv(folder / "episodes.csv", list(episode_rows(both)))
    found = [
        trace(policy="mine", scene="step"),
        trace(4.0, 41, policy="level", scene="step"),
        trace(2.0, 21, policy="mine", scene="step", episode=1, outcome="overturned"),
    ]
    write_traces(folder / TRACES, found)
    report.write(folder, folder / report.FILE)
    return folder / report.FILE


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium.chromium(draws=False) as opened:
        yield opened


@pytest.fixture
def opened(browser: Any, page_file: Path) -> Iterator[Callable[..., Any]]:
    """A function that opens the report; at the end, nothing was requested or complained of."""
    contexts, requests, complaints = [], list[str](), list[str]()

    def open_page(width: int = 1280, scheme: str = "light") -> Any:
        size = {"width": width, "height": 800}
        context = browser.new_context(viewport=size, color_scheme=scheme)
        contexts.append(context)
        page = context.new_page()
        page.on("request", lambda request: requests.append(request.url))
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.clock.install(time="2026-01-01T00:00:00")
        page.goto(page_file.as_uri())
        page.clock.pause_at("2026-01-01T01:00:00")  # it runs only for the times that tests say
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert set(requests) == {page_file.as_uri()}
    assert complaints == []


@pytest.mark.parametrize("width", [1280, 800, 390])
def test_nothing_is_cut_or_lies_over_something_else(opened: Callable[..., Any], width: int) -> None:
    page = opened(width)
    assert page.locator("figure svg:visible").count() == 2
    assert chromium.crowded(page) == []


def test_hashes_break_and_names_do_not(browser: Any, tmp_path: Path) -> None:
    words = "eval", "okada", "geometric", "terrain=flat", "--episodes", "1", "--output", "results"
    assert call(*words, cwd=tmp_path).code == 0
    page = browser.new_page(viewport={"width": 390, "height": 800})
    page.goto((tmp_path / "results" / report.FILE).as_uri())
    digest = page.locator(".origin td", has_text=re.compile("^[0-9a-f]{64}$"))
    assert digest.count() == 3
    assert chromium.crowded(page) == []
    page.close()


def clock(page: Any) -> str:
    return str(page.locator("#clock").inner_text())


def nose(page: Any, stage: int = 0) -> float:
    """The x of the front hinge of a robot [m]."""
    hinge = page.locator(".stage").nth(stage).locator(".hinge").first
    return float(hinge.get_attribute("cx"))


def test_it_shows_the_words_the_table_and_the_failure(opened: Callable[..., Any]) -> None:
    page = opened()
    assert page.locator("h1").inner_text() == "mine and level on step"
    assert "1 of 10 episodes failed: mine 1 (1 overturned)." in page.locator(".lead").inner_text()
    cells = page.locator("table").first.locator("tbody td").all_inner_texts()
    assert [text.strip() for text in cells[:3]] == ["mine", "80 % [37.6, 96.4]", "1 overturned"]
    assert page.locator("figure svg:visible").count() == 2
    assert page.locator(".failures li").count() == 1
    shown = page.locator(".poster .chassis").first.bounding_box()
    assert shown["width"] > 20  # the robot stands in its picture
    for svg in page.locator("svg[role=img]").all():
        assert svg.get_attribute("aria-label")


def test_the_player_plays_pauses_and_moves_by_clicks(opened: Callable[..., Any]) -> None:
    page = opened()
    assert page.locator(".stage b").all_inner_texts() == ["mine", "level"]
    start = nose(page)
    page.locator("#play").click()
    page.clock.run_for(3000)
    page.locator("#play").click()
    seconds = float(clock(page).split(" of ")[0])
    assert seconds == pytest.approx(6.0, abs=0.11)  # at twice the speed
    assert clock(page).endswith(" of 30.0 s")
    assert nose(page) - start == pytest.approx(seconds / 5, abs=0.02)  # it drives 0.2 m/s
    page.clock.run_for(1000)
    assert float(clock(page).split(" of ")[0]) == seconds
    page.locator("#time").fill("25")
    assert nose(page) - nose(page, 1) == pytest.approx(1.0)  # level stopped at 20 s and 4 m
    badges = page.locator(".badge").all_inner_texts()
    assert badges == ["reached after 30.0 s", "reached after 20.0 s"]
    box = page.locator(".plot svg").first.bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + 10)
    assert clock(page) == "15.0 of 30.0 s"
    page.locator("#two").select_option("none")
    assert page.locator(".stage").count() == 1
    page.locator("#speed").select_option("8 ×")
    page.locator("#play").click()
    page.clock.run_for(4000)  # past the end, where it stops
    assert clock(page) == "30.0 of 30.0 s"
    assert "Play" in page.locator("#play").inner_text()


def test_the_player_hears_keys_and_a_failure_opens_in_it(opened: Callable[..., Any]) -> None:
    page = opened()
    page.locator("#player").focus()
    pressed = ("ArrowRight", "ArrowRight", "ArrowLeft", "Shift+ArrowRight", "End", "Home")
    times = []
    for key in pressed:
        page.keyboard.press(key)
        times.append(clock(page).split(" of ")[0])
    assert times == ["0.6", "1.2", "0.6", "0.7", "30.0", "0.0"]
    page.keyboard.press("Space")
    page.clock.run_for(1000)
    page.keyboard.press("Space")
    assert float(clock(page).split(" of ")[0]) > 1
    page.locator(".failures button").click()
    page.keyboard.press("Space")
    assert page.locator("#episode").input_value() == "1"
    assert page.locator(".badge").all_inner_texts() == ["overturned at 10.0 s"]


def test_a_dark_browser_gets_a_dark_page_and_paper_a_light_one(opened: Callable[..., Any]) -> None:
    def colours(page: Any) -> tuple[str, str]:
        style = "getComputedStyle(document.body)"
        found = page.evaluate(f"[{style}.backgroundColor, {style}.color]")
        return tuple(found)

    def brightness(colour: str) -> float:
        return sum(map(float, colour.removeprefix("rgb(").removesuffix(")").split(","))) / 765

    for scheme, is_dark in (("light", False), ("dark", True)):
        page = opened(scheme=scheme)
        paper, ink = map(brightness, colours(page))
        assert (paper < ink) == is_dark
        assert abs(paper - ink) > 0.7
    page.emulate_media(media="print")
    paper, ink = map(brightness, colours(page))
    assert paper == 1.0 > ink
    assert not page.locator("#play").is_visible()
    assert page.locator(".stage svg.scene").first.is_visible()
    assert page.locator(".failures pre").count() == page.locator(".failures pre:visible").count()


def test_a_phone_scrolls_down_alone(opened: Callable[..., Any]) -> None:
    page = opened(width=360)
    assert page.evaluate("document.documentElement.scrollWidth") == 360
    widths = [svg.bounding_box()["width"] for svg in page.locator("svg.scene").all()]
    assert all(200 < width < 360 for width in widths)
    page.locator("#play").click()
    page.clock.run_for(500)
    assert nose(page) > 0.28
