"""Sphinx builds these pages: ``make docs``. Nothing is read from the network."""

from flipperctl import __version__

project = "flipperctl"
author = "the authors of flipperctl"
version = release = __version__

extensions = ["myst_parser"]
myst_heading_anchors = 3
source_suffix = {".md": "markdown"}
nitpicky = True

html_theme = "furo"
html_title = f"flipperctl {version}"
html_copy_source = False
