"""Installs the node, its launch files and its configuration where ROS 2 looks for them."""

from pathlib import Path

from setuptools import setup

NAME = "flipperctl_ros"
FOLDERS = "launch", "config", "rviz"

setup(
    name=NAME,
    version="0.3.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *((f"share/{NAME}/{f}", [str(p) for p in sorted(Path(f).iterdir())]) for f in FOLDERS),
    ],
    install_requires=["setuptools"],  # flipperctl itself is installed by pip, see README.md
    zip_safe=True,
    entry_points={
        "console_scripts": [f"node = {NAME}.node:main", f"messages = {NAME}.messages:main"]
    },
)
