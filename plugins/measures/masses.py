"""What measures need of the robot beyond its geometry."""

from flipperctl.api import Robot, RobotGeometry


def flipper_share(robot: RobotGeometry) -> float:
    """Return the mass of each flipper pair as a fraction of the robot's [-]."""
    masses = robot if isinstance(robot, Robot) else Robot()
    return masses.flipper_mass / masses.mass


def track_speed(robot: RobotGeometry) -> float:
    """Return the speed of the belts [m/s]."""
    return (robot if isinstance(robot, Robot) else Robot()).track_speed
