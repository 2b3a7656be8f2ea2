"""The list of packages; everything else stands in pyproject.toml.

The folders ``plugins`` and ``configs`` are installed under other names than their own, which
neither ``[tool.setuptools.packages.find]`` nor a list of patterns can say.
"""

from setuptools import find_packages, setup

FOLDERS = {
    "flipperctl": "flipperctl",
    "flipperctl.configs": "configs",
    "flipperctl_plugins": "plugins",
}

packages = ["hydra_plugins"]
for package, folder in FOLDERS.items():
    packages += [package, *(f"{package}.{inner}" for inner in find_packages(folder))]
setup(packages=packages)
