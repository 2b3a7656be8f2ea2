"""The task as a Gymnasium environment, ``flipperctl/Flipper-v0``.

Data flows one way: terrain → profile → world → state → observation → action → world →
transition → reward terms.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, get_args

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from flipperctl.api import (
    SAMPLE_PERIOD,
    DrawingWorld,
    FloatArray,
    Mounting,
    Outcome,
    Profile,
    RobotState,
    Transition,
)
from flipperctl.config import EnvConfig, with_overrides
from flipperctl.config.identity import foreign_plugins
from flipperctl.config.reward_sum import RewardSum
from flipperctl.core.building import built
from flipperctl.core.targets import Action, ActionKind, allowed, as_action
from flipperctl.env import ground, repeating, start
from flipperctl.env.drive import Drive
from flipperctl.env.metrics import DRAWN, EpisodeMetrics, Pitches, measures
from flipperctl.env.perceiving import Perceiver, SceneSimulator, initial_copy
from flipperctl.env.pictures import (
    HEIGHT,
    MODES,
    WIDTH,
    Observer,
    Perceived,
    Picture,
    Renderer,
    Scene,
    attach,
    installed,
)
from flipperctl.env.repeating import require_unmoved
from flipperctl.env.start import run_out_of
from flipperctl.errors import ConfigError
from flipperctl.plugging import plugins
from flipperctl.plugging.checked import require
from flipperctl.plugging.randomness import global_states
from flipperctl.text.files import at_home
from flipperctl.text.messages import close_match

Observation = NDArray[np.float32]


def _checked(seed: int | None) -> int | None:
    """Return a seed; gymnasium would take true for 1."""
    if isinstance(seed, bool):
        raise ValueError(f"seed: a number is allowed; the value is {seed}")
    return seed


class FlipperEnv(gymnasium.Env[Observation, Any]):
    """One robot drives across one terrain in each episode; the policy turns its flippers.

    Observations are (n,) float32 in SI units in the order of ``layout``. Actions are indices into
    ``flipperctl.api.ACTIONS`` or rates: the turns of the front and the rear pair, each from -1 to 1
    angle steps. With ``robot.flippers=four`` they are indices into ``actions_of(4)``, 0 to 80, or
    four rates. ``step`` takes both; ``actions`` chooses the action space. ``info`` holds
    ``rewards`` (the weighted value of each term) and, at the end, ``outcome`` and ``metrics``. A
    timeout truncates the episode; every other outcome terminates it.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # as gymnasium.Env declares it
        "render_modes": list(MODES),
        "render_fps": 10,
    }

    def __init__(
        self,
        terrain: Any = "stair",
        *,
        config: EnvConfig | None = None,
        actions: ActionKind = "turns",
        render_mode: str | None = None,
        renderer: Renderer | None = None,
        seed: int | None = None,
        **overrides: Any,
    ) -> None:
        """Configure the task; ``config`` replaces ``terrain`` and ``overrides``.

        ``terrain``: a name, a mapping with ``name`` and fields, or an instance. ``overrides``:
        sections, nested (``episode={"slack": 2}``) or dotted (``**{"rewards.pitch.lambda_2": 8}``);
        ``rewards={}`` removes every term. ``actions``: ``"turns"`` for ``Discrete(3^J)``,
        ``"rates"`` for ``Box(-1, 1, (J,))``. ``renderer`` draws the scenes of engines that draw no
        pictures themselves; by default it is the installed one. ``seed``: that of the first reset,
        unless it has its own.

        Raises:
            ConfigError: a setting, value, plugin or render mode does not exist.
        """
        if render_mode not in (None, *MODES):
            raise ConfigError(
                f"render_mode: there is no mode {render_mode!r}"
                f"{close_match(str(render_mode), MODES)}; None or {MODES[0]!r} is allowed"
            )
        # Plugins first: the terrain and the overrides may name theirs.
        if config is None:
            plugins.load()
            config = with_overrides(EnvConfig(terrain=at_home(terrain)), at_home(overrides))
        self.config = config
        self.robot, self.engine = config.robot, config.sim
        """The robot and the engine with the values sampled for the episode."""
        self.layout = config.perception.layout
        self.render_mode = render_mode
        self._reward, self._measures = RewardSum(config.rewards), measures()
        parts = (config.terrain, config.sim, config.perception, *config.rewards.values())
        self.foreign = foreign_plugins([*parts, *self._measures.values()])
        """Plugins of the episodes that are not part of flipperctl."""
        self.observers: tuple[Observer, ...] = ()
        """Observers of the episodes that begin from now on."""
        # Bounds of the space: heights up to ``ground.HIGHEST``, then angles.
        high = np.full(self.layout.size, math.pi)
        high[: self.layout.heights] = 100.0
        self.observation_space = gymnasium.spaces.Box(
            -high.astype(np.float32), high.astype(np.float32)
        )
        if actions not in get_args(ActionKind):
            raise ConfigError(f"actions: {actions!r}; turns or rates is allowed")
        self.actions = actions
        self._joints = len(self.robot.joints)
        self.action_space: gymnasium.Space[Any] = (
            gymnasium.spaces.Box(-1.0, 1.0, (self._joints,))
            if actions == "rates"
            else gymnasium.spaces.Discrete(3**self._joints)
        )
        self.renderer = self._renderer = renderer
        self._generated: Profile | None = None  # before thinning
        self._prepared: Profile  # after it
        self._last_move: tuple[int, ...] | None = None
        self._outcome: Outcome | None = None
        self._replayed: repeating.Replayed | None = None
        self._first_seed = _checked(seed)
        self._checked = True
        """Whether every value of the episode's plugins is checked, as in the first one."""
        self._seed: int | None = None
        self.running = False
        """Whether an episode runs: ``reset`` began it, and it has not ended."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Generate a terrain and place the robot in front of it; equal seeds give equal episodes.

        ``options``: ``difficulty`` from 0 to 1 for terrains that use it; without it, it is 1.

        Raises:
            ValueError: the difficulty is not a number from 0 to 1, or the seed true or false.
            TerrainError: the terrain generates no ground that a robot can start on.
            PluginFailedError: the terrain, engine or sensor returned what is not allowed.
        """
        difficulty = ground.asked_difficulty(options)
        # The constructor's seed serves the first reset alone.
        seed = self._first_seed if seed is None else _checked(seed)
        self._checked = self._checked and self._generated is None
        self.running, self._first_seed = False, None
        # Plugins of others are watched for draws from global generators.
        before = global_states() if self.foreign else None
        super().reset(seed=seed)
        self._begin(difficulty, seed)
        self._seed = seed
        require_unmoved(before, self.foreign, "at the start of an episode")
        return self.perception.observation.copy(), {}

    def _begin(self, difficulty: float, seed: int | None) -> None:
        """Begin an episode with the next children of the environment's generator."""
        spawned = repeating.children(self.np_random)
        # Each has a generator of its own, so that sensing noise never changes the terrain.
        terrain_rng, start_rng, *rngs, randomise_rng = self.np_random.spawn(5)
        # Spawned from the start's, so that the others stay the same, here and in later episodes.
        (self._engine_rng,) = start_rng.spawn(1)
        config = self.config
        sampled = config.sample(randomise_rng)
        sections = config.with_sampled_values(sampled)
        self.engine, self.robot, _ = sections
        self._sections = sections
        # An error names the seed of its episode, so that it can be repeated, if it drew anything.
        drawing = terrain_rng.bit_generator, start_rng.bit_generator
        undrawn = [generator.state for generator in drawing]
        try:
            self.profile = self._generate(terrain_rng, difficulty)
            starts = self._place(start_rng)
            if self.profile.run_up is not None and start.is_lifted(self.drive.world, self._start):
                self.profile = start.ahead(self.profile)  # beside the line there is no place for it
                starts = self._place(start_rng)
            start.check_placed(self.drive.world, self._start, config, self.profile)
        except Exception as error:  # whatever it is, it goes on with the seed
            drew = bool(sampled) or [generator.state for generator in drawing] != undrawn
            if seed is not None and drew:
                error.add_note(f"the episode's seed is {seed}")
            raise
        self._rngs = rngs[0], rngs[1]
        # Observers are attached before the first measurement, which they receive, too.
        attach(self.observers, self.drive, self.profile)
        self._perceiver = self._new_perceiver(self.drive, self._rngs)
        self._perceiver.attach(self.drive, *(o.measured for o in self.observers))
        self._sampled_values = {**starts, **sampled}
        self._last_move, self._outcome = None, None
        self._pitches = Pitches()
        self._pitches.append(self.state.pitch)
        self._metrics = EpisodeMetrics(self._measures)
        self.perception = self._perceiver.perceive(self.drive.delayed_state)
        self._replayed = repeating.Replayed(spawned, difficulty)
        self.running = True

    def __getstate__(self) -> dict[str, Any]:
        """Return what repeats the episode so far; observers stay with the original."""
        return repeating.state_of(self, self._replayed)

    def __setstate__(self, saved: dict[str, Any]) -> None:
        """Repeat the episode of ``__getstate__``; see ``repeating.restore``."""
        repeating.restore(self, saved, self._begin)

    def _place(self, rng: np.random.Generator) -> dict[str, float]:
        """Place the robot at a sampled start; return what was drawn for it, by name."""
        self._start, drawn = start.sampled(self.profile, self.robot, self.config.episode, rng)
        self.drive = self._drive()
        return drawn

    def _drive(self) -> Drive:
        config = self.config
        period = config.robot.decision_period
        rng = initial_copy(self._engine_rng)  # so that all worlds of the episode are equal
        return Drive(
            *(self.profile, self._sections, config.episode, self._start, period, rng),
            checked=self._checked,
        )

    def _new_perceiver(
        self,
        drive: Drive,
        rngs: tuple[np.random.Generator, np.random.Generator],
        exact: bool = False,
    ) -> Perceiver:
        episode, (engine, robot, sensor) = self.config.episode, self._sections
        # Level ground may come into view behind the start and past the finish.
        run_up, run_out = start.run_up_of(self.profile, episode), run_out_of(self.profile, episode)
        beyond = max(run_up + episode.start_noise, run_out) + self.layout.reach + 2.0
        margin = max(0.0, beyond)  # start and finish may both lie far inside the obstacle
        # What is constant within an episode, such as a bias, has a generator of its own.
        (mounted,) = rngs[0].spawn(1)
        gravity, world = engine.shared_setting("gravity") or Mounting.gravity, drive.world
        mounting = Mounting(robot, self.profile, margin, world, mounted, gravity, world)
        if exact:  # includes the sampled physics
            friction = engine.shared_setting("friction")
            sensor = require(sensor, "exact", sensor.exact())
        else:
            robot, friction = self.config.robot, None
        return Perceiver(sensor, mounting, robot, rngs, friction, checked=self._checked)

    def map_points(self) -> FloatArray | None:
        """Return the points of the sensor's map now, (P, 3) in frame L [m]; None without a map."""
        return self._perceiver.map_points()

    def simulator(
        self, report_progress: Callable[[float], None] = lambda fraction: None
    ) -> SceneSimulator:
        """Return a copy of the episode's scene at its start; using it does not affect the episode.

        ``report_progress`` is called with the completed fraction of a search, in [0, 1].
        """
        # Copies of the generators in their first state repeat the noise of the episode.
        first, second = self._rngs

        def perceiver(drive: Drive, exact: bool) -> Perceiver:
            copy = self._new_perceiver(drive, (initial_copy(first), initial_copy(second)), exact)
            copy.attach(drive)
            return copy

        simulator = SceneSimulator(self._drive, perceiver, self.profile, report_progress)
        simulator.seed = self._seed
        return simulator

    @property
    def state(self) -> RobotState:
        """True state of the robot."""
        return self.drive.state

    def _generate(self, rng: np.random.Generator, difficulty: float) -> Profile:
        terrain = self.config.terrain
        # Where a plugin draws is clearest here, where the terrain alone has run.
        foreign = foreign_plugins([terrain]) if self.foreign else ()
        before = global_states() if foreign else None
        profile = ground.generate_profile(terrain, rng, difficulty)
        require_unmoved(before, foreign, "in generate")
        if profile is not self._generated:  # recorded ground returns the same profile each time
            radius = self.config.robot.track_radius
            self._prepared = ground.prepare_profile(profile, terrain, radius)
            self._generated = profile
        return self._prepared

    @property
    def points_drawn(self) -> int:
        """Number of points in the generated profile, before thinning for the tracks [-]."""
        return 0 if self._generated is None else len(self._generated.points)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Turn the flippers by one action and simulate one decision.

        Raises:
            ValueError: there is no such action.
            ResetNeeded: no episode is running.
            PluginFailedError: a reward, measure, engine or sensor returned what is not allowed.
            NonFiniteError: the state or a reward is not a finite number.
        """
        taken: Action | None = as_action(action, self._joints)
        if taken is None:
            raise ValueError(f"there is no action {action!r}; {allowed(self._joints)}")
        if not self.running or self._replayed is None:
            raise ResetNeeded("no episode is running: call reset before step")
        states = global_states() if self.foreign else None
        # A copy of the environment repeats these actions.
        self._replayed.actions.append(taken)
        before = self.state
        outcome = self.drive.decide(taken)
        after, move = self.state, self.drive.moves[self.drive.action]
        previous = self._last_move or (0,) * self._joints
        self._last_move, self._outcome = move, outcome
        pitches, poses = self._pitches.append(after.pitch), self.drive.poses
        self.transition = built(
            Transition,
            before=before,
            after=after,
            pitches=pitches,
            action=move,
            profile=self.profile,
            robot=self.robot,
            outcome=outcome,
            path=poses[:, :3],
            previous_action=previous,
            flippers=poses[:, 3:],
            sample_period=SAMPLE_PERIOD,
            perception=self.perception,
            flipper_work=self.drive.flipper_work,
            roll_variation=self.drive.roll_variation,
            commands=self.drive.commands,
        )
        parts = self._reward(self.transition)
        self._metrics.add(self.transition, parts)
        # Observers get the perception on which the policy decided, before the next one replaces it.
        for observer in self.observers:
            observer.decided(self.transition, self.perception, parts)
        self.perception = self._perceiver.perceive(self.drive.delayed_state)
        if states is not None:
            used = [plugin for plugin in self.foreign if plugin.kind != "terrain"]
            require_unmoved(states, used or self.foreign, "in a decision")
        info: dict[str, Any] = {"rewards": dict(parts)}
        # The last decision brings the metrics of the whole episode.
        if outcome is not None:
            self.running = False
            info["outcome"] = outcome
            info["metrics"] = {
                "terrain": self.profile.label,
                **self._metrics.summary(),
                **self._sampled_values,
                **{f"{DRAWN}{name}": value for name, value in self.profile.drawn.items()},
            }
        # Only a timeout truncates; every other outcome belongs to the task.
        truncated = outcome is Outcome.TIMEOUT
        terminated = outcome is not None and not truncated
        reward = sum(parts.values())
        return self.perception.observation.copy(), reward, terminated, truncated, info

    @property
    def scene(self) -> Scene:
        """The current instant as plain data; ``ResetNeeded`` if no episode has begun."""
        self._require_episode()
        return Scene(
            terrain=self.config.terrain.plugin_name,
            ground=self.profile.points,
            start=self.profile.start - start.run_up_of(self.profile, self.config.episode),
            finish=self.drive.termination.finish,
            track_speed=self.robot.track_speed,
            robot=self.robot,
            state=self.state,
            perceived=Perceived.of(self.perception),
            action=self._last_move,
            outcome=self._outcome,
        )

    def _require_episode(self) -> None:
        if self._generated is None:
            raise ResetNeeded("no episode has begun: call reset first")

    def render(self) -> Picture | None:
        """Return a picture, (HEIGHT, WIDTH, 3); None without ``render_mode="rgb_array"``.

        The engine draws it, if its world is a ``DrawingWorld``; else it is the scene from the side.

        Raises:
            ResetNeeded: no episode has begun.
            RequestError: the machine lacks a library that the engine needs for drawing.
        """
        if self.render_mode is None:
            return None
        self._require_episode()
        if isinstance(self.drive.world.of_engine, DrawingWorld):
            picture: Picture = self.drive.world.draw(WIDTH, HEIGHT)
            return picture
        if self._renderer is None:
            self._renderer = installed()
        return self._renderer(self.scene)
