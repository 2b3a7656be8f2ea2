"""The whole contract for plugin authors: the values, the plugin families and their decorators.

In: nothing of the rest of flipperctl. Out: everything that a plugin may import.
SI units and radians throughout. Frames: world (x forward, z up, the profile's own
coordinates), L (origin at the chassis centre, level), R (origin at the chassis centre, x along
the chassis). Signs: a flipper angle is positive when the flipper is above the chassis, front
and rear alike; the pitch is positive nose up.
"""

from flipperctl.api.controllers import Controller, Policy, Simulator, controller
from flipperctl.api.engines import (
    NO_LIMITS,
    SAMPLE_PERIOD,
    Engine,
    Limits,
    Start,
    World,
    engine,
)
from flipperctl.api.networks import Network, network
from flipperctl.api.plugin import NAME_RULE, Plugin, is_plugin_name, registry
from flipperctl.api.rewards import RewardTerm, Shaping, reward
from flipperctl.api.robot import Robot
from flipperctl.api.sensors import GroundSensor, SensedAngles, SensedGround, Sensor, sensor
from flipperctl.api.terrains import AnyTerrain, Terrain, terrain
from flipperctl.api.values import (
    ACTIONS,
    MEMORY,
    FloatArray,
    ObservationLayout,
    Outcome,
    Perception,
    Profile,
    RobotGeometry,
    RobotState,
    Settings,
    Transition,
    action_index,
    candidate_angle,
)

__all__ = [
    "ACTIONS",
    "MEMORY",
    "NAME_RULE",
    "NO_LIMITS",
    "SAMPLE_PERIOD",
    "AnyTerrain",
    "Controller",
    "Engine",
    "FloatArray",
    "GroundSensor",
    "Limits",
    "Network",
    "ObservationLayout",
    "Outcome",
    "Perception",
    "Plugin",
    "Policy",
    "Profile",
    "RewardTerm",
    "Robot",
    "RobotGeometry",
    "RobotState",
    "SensedAngles",
    "SensedGround",
    "Sensor",
    "Settings",
    "Shaping",
    "Simulator",
    "Start",
    "Terrain",
    "Transition",
    "World",
    "action_index",
    "candidate_angle",
    "controller",
    "engine",
    "is_plugin_name",
    "network",
    "registry",
    "reward",
    "sensor",
    "terrain",
]
