"""Short courses, and what the prediction model makes of them."""

from collections.abc import Mapping

import numpy as np

from flipperctl.api import Profile, RewardTerm, Robot
from flipperctl.config.reward_sum import RewardSum
from flipperctl.lookahead.model import Model, Nodes
from flipperctl.lookahead.value_iteration import Course, Graph

ROBOT = Robot()
FLAT = Profile([(0.0, 0.0), (0.1, 0.0)])
STEP = Profile([(0.0, 0.0), (0.0, 0.2), (0.3, 0.2)])
WALL = Profile([(0.0, 0.0), (0.0, 1.5), (0.3, 1.5)])
START, FINISH, PATIENCE, GAMMA = -0.6, 0.6, 20, 0.99
CLEARANCE = 0.1
"""Largest height of the chassis' higher end above the ground at the finish [m]."""


def model_of(profile: Profile, finish: float = FINISH, friction: float = 1.0) -> Model:
    top = profile.height(finish) + ROBOT.track_radius + CLEARANCE
    return Model(profile.points, ROBOT, friction, iterations=8, finish=finish, top=top)


def graph_of(profile: Profile, terms: Mapping[str, RewardTerm], friction: float = 1.0) -> Graph:
    course = Course(profile, START, FINISH, PATIENCE)
    model = model_of(profile, friction=friction)
    return Graph(course, model, ROBOT, RewardSum(terms), GAMMA)


def standing(model: Model, x: float, z: float = 0.1) -> Nodes:
    """Return one robot with level flippers, its chassis centre at x and z [m]."""
    state = model.state((x, z, 0.0), (0.0, 0.0))
    return Nodes.at_rest(state[None], np.array([[x, z]]))
