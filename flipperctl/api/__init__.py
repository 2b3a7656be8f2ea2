"""The whole contract for plugin authors: the values, the plugin families and their decorators.

Plugins import this package and ``flipperctl.core``, which is all that this package imports itself.
SI units and radians throughout. Frames: world (x forward, z up, the profile's own
coordinates), L (origin at the chassis centre, level), R (origin at the chassis centre, x along
the chassis). Signs: a flipper angle is positive when the flipper is above the chassis, front
and rear alike; the pitch is positive nose up.
"""

from flipperctl.api.commands import Subcommand, command
from flipperctl.api.controllers import (
    Controller,
    CostPolicy,
    LearnedValue,
    Network,
    Policy,
    Simulator,
    StateGroups,
    Task,
    TrainingEpisodes,
    ValuedPolicy,
    controller,
    network,
)
from flipperctl.api.engines import (
    NO_LIMITS,
    SAMPLE_PERIOD,
    BeltWorld,
    CameraImage,
    CameraWorld,
    DrawingWorld,
    EndingWorld,
    Engine,
    Limits,
    PoweredWorld,
    RayWorld,
    RollingWorld,
    SharedSetting,
    Start,
    View,
    World,
    engine,
)
from flipperctl.api.learners import (
    FailureRisk,
    Learner,
    Learning,
    Loop,
    Step,
    Training,
    learner,
)
from flipperctl.api.plugin import NAME_RULE, Plugin, is_plugin_name, registry
from flipperctl.api.profile import MirroredSurface, Profile, Surface
from flipperctl.api.ranges import IntRange, Range
from flipperctl.api.records import Listener, Logger, Measure, RunInfo, logger, measure, scalars
from flipperctl.api.rewards import RewardTerm, Shaping, limited, reward
from flipperctl.api.robot import Robot, candidate_angle, candidate_angles
from flipperctl.api.sensors import GroundSensor, Instrument, Mounting, Sensor, sensor
from flipperctl.api.terrains import AnyTerrain, Published, Terrain, terrain
from flipperctl.api.transitions import LAST_PITCHES, RobotStates, Transitions
from flipperctl.api.values import (
    MAX_HISTORY,
    Command,
    ObservationLayout,
    Outcome,
    Perception,
    RecordedEpisode,
    RobotGeometry,
    RobotState,
    Settings,
    Transition,
)
from flipperctl.core import FloatArray
from flipperctl.core.sensing import Estimator, Measured, SensedAngles, SensedGround
from flipperctl.core.targets import ACTIONS, action_index

__all__ = [
    "ACTIONS",
    "LAST_PITCHES",
    "MAX_HISTORY",
    "NAME_RULE",
    "NO_LIMITS",
    "SAMPLE_PERIOD",
    "AnyTerrain",
    "BeltWorld",
    "CameraImage",
    "CameraWorld",
    "Command",
    "Controller",
    "CostPolicy",
    "DrawingWorld",
    "EndingWorld",
    "Engine",
    "Estimator",
    "FailureRisk",
    "FloatArray",
    "GroundSensor",
    "Instrument",
    "IntRange",
    "LearnedValue",
    "Learner",
    "Learning",
    "Limits",
    "Listener",
    "Logger",
    "Loop",
    "Measure",
    "Measured",
    "MirroredSurface",
    "Mounting",
    "Network",
    "ObservationLayout",
    "Outcome",
    "Perception",
    "Plugin",
    "Policy",
    "PoweredWorld",
    "Profile",
    "Published",
    "Range",
    "RayWorld",
    "RecordedEpisode",
    "RewardTerm",
    "Robot",
    "RobotGeometry",
    "RobotState",
    "RobotStates",
    "RollingWorld",
    "RunInfo",
    "SensedAngles",
    "SensedGround",
    "Sensor",
    "Settings",
    "Shaping",
    "SharedSetting",
    "Simulator",
    "Start",
    "StateGroups",
    "Step",
    "Subcommand",
    "Surface",
    "Task",
    "Terrain",
    "Training",
    "TrainingEpisodes",
    "Transition",
    "Transitions",
    "ValuedPolicy",
    "View",
    "World",
    "action_index",
    "candidate_angle",
    "candidate_angles",
    "command",
    "controller",
    "engine",
    "is_plugin_name",
    "learner",
    "limited",
    "logger",
    "measure",
    "network",
    "registry",
    "reward",
    "scalars",
    "sensor",
    "terrain",
]
