"""What ``flipperctl watch`` shows: states, meshes, text, and the page in a real browser."""

import io
import math
import re
import threading
from collections.abc import Iterator
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from benchmarks import browser
from flipperctl.api import ACTIONS, Profile, Robot, RobotState
from flipperctl.config import EvalConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import RequestError
from flipperctl.live import lanes, page, scene, terminal
from flipperctl.live.gate import Gate
from flipperctl.live.lanes import Entrant, Episode, Lane
from flipperctl.plugging.plugins import load
from flipperctl.policies.source import load_policy

STEP = Profile([(0.0, 0.0), (0.0, 0.2), (1.0, 0.2), (1.0, 0.0)])
STILL = RobotState(
    position=np.array([0.0, 0.1]), pitch=0.0, front=0.0, rear=0.0, velocity=np.zeros(2),
    pitch_rate=0.0, time=0.0,
)  # fmt: skip


def entrant(name: str = "okada", terrain: str = "step") -> Entrant:
    load(())
    config = EvalConfig(terrain=terrain)

    def episode(index: int) -> Episode:
        return Episode(config, load_policy(name).build(config), 7 + index)

    return Entrant(name, episode)


def test_flippers_turn_up_on_both_ends() -> None:
    robot = Robot()
    axle = robot.flipper_axle
    front, rear = (scene._about_y(-0.5), axle), (scene._about_y(0.5), -axle)
    for (w, _, y, _), x in (front, rear):
        raised = -math.sin(2 * math.atan2(y, w)) * x  # of a tip at x that is turned about y
        assert raised == pytest.approx(robot.flipper_axle * math.sin(0.5))


def test_a_lane_shows_the_states_of_its_episode() -> None:
    lane = Lane(entrant())
    first = lane.begin(0)
    assert [s.time for s in first.states] == [0.0]
    times, variation = [0.0], 0.0
    while (moment := lane.step()) is not None:
        assert moment.decision is not None
        times += [state.time for state in moment.states]
        variation += float(np.abs(np.diff(moment.decision.poses[:, 2])).sum())
        assert moment.states[-1].time <= moment.decision.transition.after.time + 1e-9
        assert moment.decision.transition.after.time - moment.states[-1].time < lanes.PERIOD
    assert np.diff(times).max() <= lanes.PERIOD + 1e-9
    assert np.diff(times).min() > 0
    assert lane.history.variation == pytest.approx(variation)
    assert lane.outcome is not None


def test_the_table_outlines_the_chosen_action() -> None:
    values = [float(i) for i in range(9)]
    table = page.value_table(values, 3)
    (chosen,) = re.findall(r"outline[^>]*>([\d.]+)<", table)
    assert chosen == "3.00"
    assert table.index("rear ↑") < table.index("rear ↓")
    assert len(re.findall(r"<td", table)) == len(ACTIONS)


def test_the_picture_has_ground_below_the_robot() -> None:
    rows = terminal.picture(STEP, Robot(), STILL).splitlines()
    blank = chr(0x2800)
    assert len({len(row) for row in rows}) == 1
    assert all(character == blank for character in rows[0])
    bottom = max(i for i, row in enumerate(rows) if row.strip(blank))
    assert rows[bottom][0] != blank  # level ground at the left end


def test_the_terminal_prints_a_line_for_each_decision() -> None:
    out = io.StringIO()
    terminal.watch(entrant("level"), out, speed=10, episodes=1)
    lines = out.getvalue().splitlines()
    assert lines[0] == "level on step, episode 0"
    assert "reached" in lines[-1]
    assert max(map(len, lines)) <= 100


SELDOM = """const draw = window.requestAnimationFrame;
window.requestAnimationFrame = frame => setTimeout(() => draw(frame), 300)"""


@pytest.fixture
def served() -> Iterator[tuple[Gate, page.WatchPage]]:
    with Gate(0) as gate:
        # Without a graphics card, either takes a browser seconds to begin with.
        gate.server.scene.configure_environment_map(None)
        gate.server.scene.configure_default_lights(cast_shadow=False)
        shown = page.WatchPage(gate.server, [entrant("generalist"), entrant("level")], speed=2)
        thread = threading.Thread(target=shown.run, daemon=True)
        thread.start()
        yield gate, shown
        shown.stop()
        thread.join(20)


@pytest.mark.slow
def test_the_page_is_driven_by_keys_and_buttons(
    served: tuple[Gate, page.WatchPage], play: Any
) -> None:
    from playwright.sync_api import expect

    gate, shown = served
    address = f"http://127.0.0.1:{gate.server.get_port()}"
    problems: list[str] = []

    def check(request: Any) -> None:
        if not request.url.startswith((address, "data:", "blob:", "ws://127.0.0.1")):
            problems.append(request.url)

    opened = browser.launch(play)
    tab = opened.new_page(viewport={"width": 1000, "height": 320})  # little to draw, and seldom
    tab.add_init_script(SELDOM)
    tab.set_default_timeout(120_000)
    tab.on("request", check)
    tab.on("pageerror", lambda error: problems.append(str(error)))
    tab.on("console", lambda m: problems.append(m.text) if m.type == "error" else None)
    tab.goto(gate.address)
    expect(tab.get_by_text("Q-values").first).to_be_visible(timeout=60_000)
    tab.get_by_role("button", name="Pause").click()
    expect(tab.get_by_role("button", name="Play")).to_be_visible(timeout=20_000)
    numbers = tab.get_by_text(re.compile(r"time \d+\.\d s")).first
    tab.wait_for_timeout(500)  # the running decision ends
    before = _time(numbers.inner_text())
    tab.get_by_text("Step", exact=True).click()
    expect(numbers).not_to_contain_text(f"time {before:.1f} s", timeout=20_000)
    lane = shown._lanes[0][0]
    state = lane.env.state
    tab.wait_for_timeout(500)
    assert _time(numbers.inner_text()) == pytest.approx(state.time, abs=0.6)
    after = shown._episode + 1
    tab.get_by_text("Next", exact=True).click()
    expect(tab.get_by_text(f"episode {after}").first).to_be_visible(timeout=20_000)
    shot = tab.screenshot()
    opened.close()
    assert problems == []
    assert len(shot) > 10_000


def _time(text: str) -> float:
    (found,) = re.findall(r"time (\d+\.\d) s", text)
    return float(found)


@pytest.mark.parametrize("name", ["mpc", "planner"])
def test_a_plan_is_shown_as_it_is_made(name: str) -> None:
    load(())
    config = EvalConfig(terrain={"name": "step", "height": 0.1}, episode={"run_up": 0.8})
    small = {"mpc": {"beam": 4, "horizon": 4}, "planner": {"width": 4, "budget": 500}}[name]
    source = load_policy(name, fields=small)
    lane = Lane(Entrant(name, lambda index: Episode(config, source.build(config), 3)))
    lane.begin(0)
    places, plans = [], []
    while (moment := lane.step()) is not None:
        assert moment.decision is not None
        assert moment.planned is not None
        assert moment.planned.actions[:1] == (moment.decision.action,)
        assert moment.planned.path[0].tolist() == [0.0, 0.0]
        assert len(moment.planned.path) == len(moment.planned.actions) + 1
        places.append(moment.decision.transition.before.position)
        plans.append(moment.planned)
    if name == "planner":  # it knows the ground, so that it comes as it was planned
        ahead = np.array(places[1:]) - places[0]
        assert plans[0].path[1 : len(places)] == pytest.approx(ahead, abs=1e-9)
    else:
        assert abs(plans[0].path[1, 0] - (places[1] - places[0])[0]) < 0.03
    assert page.plan_text([0] * 14) == " ".join(["↓↓"] * 12) + " and 2 more"


def test_the_map_lies_where_the_ground_is() -> None:
    load(())
    step = {"name": "step", "height": 0.2}
    env = FlipperEnv(config=EvalConfig(terrain=step))
    env.reset(seed=3)
    assert env.map_points() is None  # points of the true ground are no map
    exact = {"name": "lidar", "noise": 0.0, "range_bias": 0.0, "dropout": 0.0, "mixed": 0.0}
    env = FlipperEnv(config=EvalConfig(terrain=step, perception=exact))
    env.reset(seed=3)
    for _ in range(3):
        env.step(4)
    shown = MagicMock()
    live = scene.LiveScene(shown, "/drive/0", 0.0)
    live.begin(env.profile, env.robot, env.scene.finish, "")
    live.perceive(env.perception, env.state, env.map_points())
    clouds = {call.args[0]: call.args[1] for call in shown.add_point_cloud.call_args_list}
    x, y, z = clouds["/drive/0/perceived/map"].T
    aside = np.abs(x) > 0.05  # from the riser
    heights = np.array([env.profile.height(place) for place in x[aside]])
    assert len(x) > 1000
    assert np.abs(z[aside] - heights).max() < 0.02
    assert np.ptp(y) > 0.5


def test_a_search_tells_how_far_it_is_and_can_be_left() -> None:
    load(())
    config = EvalConfig(terrain="step")
    source = load_policy("planner", fields={"width": 4, "budget": 500})
    planner = Entrant("planner", lambda index: Episode(config, source.build(config), 3))
    told: list[float] = []
    lane = Lane(planner, told.append)
    lane.begin(0)
    lane.step()
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert len(told) > 2

    shown = page.WatchPage(MagicMock(), [planner])
    shown._set_lanes()
    shown._wish.episode = 3
    with pytest.raises(page._NextEpisodeError):  # not as a failure of the planner
        shown._play()


def test_a_policy_that_cannot_drive_is_refused_and_the_page_goes_on() -> None:
    def broken(index: int) -> Episode:
        raise RequestError("no drives")

    named, event = MagicMock(), MagicMock()
    shown = page.WatchPage(MagicMock(), [entrant()], find=lambda name: Entrant(name, broken))
    shown._add(named, event)
    assert event.client.add_notification.call_args.args == ("No policy was added", "no drives")
    assert not shown._wish.changed
    assert len(shown._entrants) == 1
