"""The simulated LiDAR; importing this package registers the sensor ``lidar``.

The fields are in ``sensor``, the instruments in ``instruments``; what a robot computes from
their messages is ``flipperctl.core.lidar``.
"""

from flipperctl.sim.lidar.sensor import LidarSensor

__all__ = ["LidarSensor"]
