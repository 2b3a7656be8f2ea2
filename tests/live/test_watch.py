"""What ``flipperctl watch`` shows: states, meshes, text, and the page in a real browser."""

import io
import json
import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from benchmarks import browser
from flipperctl.api import Profile, Robot, RobotState
from flipperctl.config import EvalConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import RequestError
from flipperctl.live import lanes, page, scene, terminal
from flipperctl.live.gate import Gate, page_file
from flipperctl.live.lanes import Entrant, Episode, Lane
from flipperctl.plugging.plugins import load
from flipperctl.policies.source import load_policy
from flipperctl.sim.mujoco.appearance import SUN
from flipperctl.sim.outline import CHASSIS, FRONT, REAR

STEP = Profile([(0.0, 0.0), (0.0, 0.2), (1.0, 0.2), (1.0, 0.0)])
STILL = RobotState(
    position=np.array([0.0, 0.1]), pitch=0.0, front=0.0, rear=0.0, velocity=np.zeros(2),
    pitch_rate=0.0, time=0.0,
)  # fmt: skip


def entrant(label: str = "okada", name: str = "") -> Entrant:
    load(())
    config, source = EvalConfig(terrain="step"), load_policy(name or label)
    return Entrant(label, lambda index: Episode(config, source.build(config), 7 + index))


def test_flippers_turn_up_on_both_ends() -> None:
    robot = Robot()
    axle = robot.flipper_axle
    front, rear = (scene._about_y(-0.5), axle), (scene._about_y(0.5), -axle)
    for (w, _, y, _), x in (front, rear):
        raised = -math.sin(2 * math.atan2(y, w)) * x  # of a tip at x that is turned about y
        assert raised == pytest.approx(robot.flipper_axle * math.sin(0.5))


def test_quaternions_are_those_of_scipy() -> None:
    from scipy.spatial.transform import Rotation

    for turn in Rotation.random(20, random_state=0):
        x, y, z, w = turn.as_quat(canonical=True)
        assert scene._quaternion(turn.as_matrix()) == pytest.approx((w, x, y, z))


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


Page = tuple[Gate, page.WatchPage]


@contextmanager
def opened_page(*entrants: Entrant, marks: bool = True) -> Iterator[Page]:
    shown = page.WatchPage(entrants, speed=2, find=lambda name: entrant(name), marks=marks)
    with Gate(0, page=page_file("watch.html"), control=shown) as gate:
        thread = threading.Thread(target=shown.run, args=(gate,), daemon=True)
        thread.start()
        try:
            yield gate, shown
        finally:
            shown.stop()
            thread.join(20)


@pytest.fixture(scope="module")
def served() -> Iterator[Page]:
    names = entrant("generalist"), entrant("a_name_of_many_letters_as_of_a_run", "okada")
    with opened_page(*names) as opened:
        yield opened


@contextmanager
def tab_of(gate: Gate, chromium: Any) -> Iterator[Any]:
    """Yield a page, without the 3-D scene, whose drawing takes a core."""
    problems: list[str] = []
    opened = chromium.new_page(viewport={"width": 1280, "height": 800})
    opened.set_default_timeout(120_000)
    opened.route("**/scene*", lambda route: route.fulfill(body="<p>scene</p>"))
    own = gate.address.split("/?")[0], "data:", "blob:"
    opened.on("request", lambda r: None if r.url.startswith(own) else problems.append(r.url))
    opened.on("pageerror", lambda error: problems.append(str(error)))
    opened.on("console", lambda m: problems.append(m.text) if m.type == "error" else None)
    opened.goto(gate.address)
    yield opened
    opened.close()
    assert problems == []


@pytest.fixture
def tab(served: Page, chromium: Any) -> Iterator[Any]:
    with tab_of(served[0], chromium) as opened:
        yield opened


@pytest.mark.slow
def test_the_page_is_driven_by_keys_and_buttons(served: Page, tab: Any) -> None:
    from playwright.sync_api import expect

    expect.set_options(timeout=60_000)
    _, shown = served
    time = tab.locator("#lane-0 [data-value=time]")
    expect(tab.locator("#lane-0 td.taken")).to_have_count(1)
    tab.get_by_role("button", name="Pause").click()
    expect(tab.get_by_role("button", name="Play")).to_be_visible()
    tab.wait_for_timeout(500)  # the running decision ends
    before = time.inner_text()
    tab.keyboard.press("s")
    expect(time).not_to_have_text(before)
    # Other episodes begin where they are asked for, paused or not.
    after = shown._episode + 1
    tab.keyboard.press("n")
    expect(tab.locator("#title")).to_have_text(f"step, episode {after}")
    tab.locator("#seed").fill("5")
    tab.keyboard.press("Tab")
    expect(tab.locator("#title")).to_have_text("step, seed 5")
    tab.get_by_role("button", name="Play").click()
    # Policies are added and hidden by their names, and errors are said.
    tab.locator("#name").fill("nobody")
    tab.keyboard.press("Enter")
    expect(tab.get_by_role("alert")).to_contain_text("nobody")
    tab.locator("#name").fill("level")
    tab.keyboard.press("Enter")
    expect(tab.locator("#lane-2 .name")).to_have_text("3 level")
    tab.get_by_label("level", exact=True).uncheck()
    expect(tab.locator("#lane-2")).to_have_count(0)


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 800, 390])
def test_nothing_is_cut_or_lies_over_something_else(tab: Any, width: int) -> None:
    require_readable(tab, width)


def require_readable(tab: Any, width: int) -> None:
    tab.set_viewport_size({"width": width, "height": 844})
    tab.locator("#lane-1 canvas").first.wait_for()
    assert browser.crowded(tab) == []
    scene, side = (tab.locator(name).bounding_box() for name in ("#view", "#side"))
    assert scene["width"] >= 0.6 * width  # and not behind the panel
    beside = side["x"] >= scene["x"] + scene["width"]
    assert beside if width > 900 else side["y"] >= scene["y"] + scene["height"]


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 4, 6])
def test_names_of_several_robots_are_whole_and_apart(chromium: Any, count: int) -> None:
    names = [f"{name}_of_a_run_with_many_letters" for name in ("a", "bb", "ccc", "d", "e", "f")]
    entrants = [entrant(name, "level") for name in names[:count]]
    with opened_page(*entrants) as (gate, _), tab_of(gate, chromium) as tab:
        shown = min(count, 4)
        tab.locator(f"#lane-{shown - 1} canvas").first.wait_for()
        for width in (1280, 800, 390):
            tab.set_viewport_size({"width": width, "height": 844})
            assert browser.crowded(tab) == []
            texts = tab.locator("#names > span").all_inner_texts()
            numbered = [f"{at + 1} {name}" for at, name in enumerate(names[:shown])]
            assert texts == (numbered if count > 1 else [names[0]])
            assert tab.locator("#names").is_visible() == (count > 1)
            scene, named = (tab.locator(part).bounding_box() for part in (".frame", "#names"))
            assert scene["height"] > 150
            assert named is None or named["y"] >= scene["y"] + scene["height"] - 1


@pytest.mark.slow
def test_the_demo_begins_without_marks_and_explains_them_when_asked(chromium: Any) -> None:
    names = entrant("generalist"), entrant("geometric")
    with opened_page(*names, marks=False) as (gate, _), tab_of(gate, chromium) as tab:
        for width in (1280, 800, 390):
            require_readable(tab, width)
        assert tab.locator("#legend.off").count() == 1
        tab.locator("#marks").check()
        tab.locator("#legend:not(.off)").wait_for()


def test_messages_that_are_none_are_refused() -> None:
    shown = page.WatchPage([entrant()])
    for message in ("", "{}", '{"kind":"do","what":"dance"}', '{"kind":"set","name":"speed"}'):
        with pytest.raises(ValueError, match="validation error"):
            shown.received(0, message)
    shown.received(0, '{"kind":"show","number":7,"on":true}')
    assert not shown._wish.changed


def test_colours_are_those_of_every_picture() -> None:
    style = (Path(page.__file__).parent / "page.css").read_text("utf-8")
    for name, colour in (("chassis", CHASSIS), ("front", FRONT), ("rear", REAR)):
        assert f"--{name}: {colour};" in style


def test_the_light_of_the_day_shows_the_colours_of_films() -> None:
    around, sun = scene._LIGHTS[False]
    shining = (around - sun * SUN[2] / math.hypot(*SUN)) / math.pi
    for colour in ("#DDD6CA", CHASSIS, FRONT, REAR):
        surface = "#{:02X}{:02X}{:02X}".format(*scene._surface(colour))
        # The filmic curve of three.js
        v = scene._BEFORE_CURVE @ (scene._linear(surface) * shining / 0.6)
        v = (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.4329510) + 0.238081)
        assert scene._AFTER_CURVE @ v == pytest.approx(scene._linear(colour), abs=0.02)


def in_picture(count: int) -> Callable[[np.ndarray], np.ndarray]:
    """Return what gives places in a picture of ``count`` lanes, (P, 2), in halves of its height."""
    server = MagicMock()
    scene.Stage(server).look_at_lanes(count)
    camera = server.initial_camera
    place, towards = np.array(camera.position), np.subtract(camera.look_at, camera.position)
    towards /= np.linalg.norm(towards)
    right = np.cross(towards, [0.0, 0.0, 1.0])
    axes = np.stack([right, np.cross(right, towards)], axis=1) / np.linalg.norm(right)
    tangent = math.tan(camera.fov / 2)
    return lambda points: (points - place) @ axes / ((points - place) @ towards)[:, None] / tangent


@pytest.mark.parametrize("apart", [(0.0, 0.0), (7.0, 0.0), (4.0, 2.6), (2.0, -1.8)])
@pytest.mark.parametrize("count", [1, 2, 4])
def test_no_robot_leaves_the_picture(count: int, apart: tuple[float, float]) -> None:
    server = MagicMock()
    stage = scene.Stage(server)
    stage.begin([scene.Laid.of(STEP)])
    lanes = [scene.LiveScene(server.scene, lane) for lane in range(count)]
    for lane in lanes:
        lane._root = MagicMock()
    world = MagicMock()
    stage._world = world
    # The first robot is far ahead, and above or below the others.
    at = np.tile([3.0, 0.1], (count, 1))
    at[0] += apart
    robots = [(lane, replace(STILL, position=p)) for lane, p in zip(lanes, at, strict=True)]
    stage.follow(robots)
    seen, half, up = in_picture(count), Robot().hinge_offset + Robot().flipper_axle + 0.1, 0.35
    for lane, (x, z) in zip(lanes, at, strict=True):
        corners = [
            (dx, dy, dz) for dx in (-half, half) for dy in (-0.35, 0.35) for dz in (-0.1, up)
        ]
        moved = np.add(lane._root.position, world.position) + np.array([x, 0.0, z])
        wide, high = np.abs(seen(np.add(corners, moved))).max(0)
        assert high < 1
        assert wide < 1.1  # of the narrowest picture, on a laptop


@pytest.mark.parametrize("count", [2, 3, 4])
def test_a_number_lies_over_no_robot_and_no_other_number(count: int) -> None:
    seen, robot = in_picture(count), Robot()

    def overlap(a: np.ndarray, b: np.ndarray) -> bool:
        return bool((np.minimum(a.max(0), b.max(0)) > np.maximum(a.min(0), b.min(0))).all())

    # Robots on level ground, which is 0.1 m below them, and numbers in the smallest picture
    height, letters = 240, np.array([[0, 0], [14, 18]])
    half, wide, up = robot.hinge_offset + robot.flipper_axle + 0.1, 0.35, 0.25
    corners = [(x, y, z) for x in (-half, half) for y in (-wide, wide) for z in (-0.1, up)]
    places = [lane * (scene.WIDTH + scene._BETWEEN) for lane in range(count)]
    bodies = [seen(np.add(corners, (0.0, y, 0.0))) for y in places]
    begins = [seen(np.array([[scene._NAME[0], y + scene._NAME[1], -0.1]])) for y in places]
    numbers = [begin + letters * 2 / height for begin in begins]
    for at, number in enumerate(numbers):
        assert not any(overlap(number, other) for other in [*bodies, *numbers[:at]])
        assert np.abs(number).max() < 1.15  # of the narrowest picture, on a laptop


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
    live = scene.LiveScene(shown)
    live.begin(env.profile, env.robot, env.scene.finish, 0.0)
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

    shown = page.WatchPage([planner])
    shown._gate, shown._stage = MagicMock(), MagicMock(**{"begin.return_value": 0.0})
    shown._set_lanes()
    shown._wish.episode = 3
    with pytest.raises(page._NextEpisodeError):  # not as a failure of the planner
        shown._play()


def test_a_policy_that_cannot_drive_is_refused_and_the_page_goes_on() -> None:
    def broken(index: int) -> Episode:
        raise RequestError("no drives")

    shown = page.WatchPage([entrant()], find=lambda name: Entrant(name, broken))
    shown._gate = MagicMock()
    shown._add("broken")
    remark = json.loads(shown._gate.post.call_args.args[0])
    assert remark == {"kind": "remark", "text": "No policy was added: no drives"}
    assert not shown._wish.changed
    assert len(shown._entrants) == 1


@pytest.fixture
def four() -> Lane:
    load(())
    words = {"terrain": {"name": "step", "height": 0.2}, "robot": {"flippers": "four"}}
    config = EvalConfig(**words, sim={"name": "mujoco", "one_sided": 1}, perception={"sides": True})
    source = load_policy("okada_sides")
    return Lane(Entrant("sides", lambda index: Episode(config, source.build(config), 3)))


def test_four_flippers_are_shown_each_by_itself(four: Lane) -> None:
    first, shown = four.begin(0), MagicMock()
    shown.add_frame.side_effect = lambda name, **_: MagicMock(name=name)
    live, ground = (
        scene.LiveScene(shown),
        scene.Laid.of(four.env.profile, four.env.drive.world.of_engine),
    )
    live.begin(four.env.profile, four.env.robot, 1.0, 0.0, ground=ground)
    state = replace(first.states[0], front=0.2, rear=0.0, flippers=(0.5, -0.1, 0.3, -0.3))
    live.show(state)
    turned = {name: part.wxyz for name, part in live._parts.items() if name != "chassis"}
    assert turned == {
        "front_left": scene._about_y(-0.5), "front_right": scene._about_y(0.1),
        "rear_left": scene._about_y(0.3), "rear_right": scene._about_y(-0.3),
    }  # fmt: skip
    # The step is on the left side alone, as in the simulator.
    right, left = (np.interp(0.1, *strip.line.T) for strip in ground.strips)
    assert right < left == pytest.approx(0.2)


def test_numbers_of_four_flippers_stand_by_side(four: Lane) -> None:
    four.begin(0)
    moment = four.step()
    assert moment is not None
    told = page.gauges(0, four, moment)
    assert told["joints"] == ["front left", "front right", "rear left", "rear right"]
    assert len(told["angles"][-1]) == 1 + 1 + 4 + 1  # time, pitch, joints, roll
    assert told["action"][0].count("/") == 1
    assert terminal.gauges(four, moment, moment.states[-1]).count("°/") == 2
