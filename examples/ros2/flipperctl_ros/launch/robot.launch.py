"""Starts the node on a robot: ros2 launch flipperctl_ros robot.launch.py policy:=stair.onnx."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode

ARGUMENTS = {
    "policy": ("policy.onnx", "an exported policy"),
    "devices": ("", "the robot's devices, a file; empty: the policy's own"),
    "namespace": ("", "namespace of the robot"),
    "enabled": ("false", "whether the policy commands before the service enable says so"),
    "shadow": ("false", "whether nothing is commanded"),
    "escape": ("false", "whether a policy that warns draws its actions"),
    "use_sim_time": ("false", "whether the clock is that of a simulator"),
}


def generate_launch_description():
    """Return the node with its arguments; it configures and activates itself."""
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, (value, text) in ARGUMENTS.items()
    ]
    node = LifecycleNode(
        package="flipperctl_ros",
        executable="node",
        name="flipperctl",
        namespace=given.pop("namespace"),
        parameters=[given],
        output="screen",
    )
    return LaunchDescription([*declared, node])
