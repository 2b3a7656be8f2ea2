"""How a load on the chassis moves the robot's centre of mass.

In: the robot. Out: the load's part of the mass, and of the centre of mass. A robot that is geometry
alone carries none.
"""

from flipperctl.api import Robot, RobotGeometry


def load_share(robot: RobotGeometry) -> float:
    """Return the load's mass as a fraction of the robot's with the load [-]."""
    return (robot.payload or 0.0) / robot.mass if isinstance(robot, Robot) else 0.0


def load_offset(robot: RobotGeometry) -> tuple[float, float]:
    """Return what the load adds to the robot's centre of mass, (x, z) in frame R [m]."""
    if not isinstance(robot, Robot):
        return 0.0, 0.0
    share = load_share(robot)
    return share * (robot.payload_x or 0.0), share * (robot.payload_z or 0.0)
