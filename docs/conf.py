"""Sphinx builds these pages: ``make docs``. Nothing is read from the network."""

import re
import sys
from pathlib import Path

from pydantic import BaseModel
from sphinx.application import Sphinx
from sphinx.config import Config

sys.path.insert(0, str(Path(__file__).parents[1]))

from docs import generate
from flipperctl import __version__

project = "flipperctl"
author = "the authors of flipperctl"
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc"]
myst_heading_anchors = 3
source_suffix = {".md": "markdown"}
add_module_names = False
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_type_aliases = {"ArrayLike": "ArrayLike", "FloatArray": "FloatArray"}
autodoc_preserve_defaults = True
autodoc_default_options = {"exclude-members": "model_config"}  # pydantic's

smartquotes_action = "qe"  # no dashes: options begin with two hyphens

html_theme = "furo"
html_title = f"flipperctl {version}"
html_copy_source = False
html_show_copyright = False
html_static_path = ["_static"]
html_css_files = ["pages.css"]


def setup(app: Sphinx) -> None:
    """Fill in what is generated from the code."""
    app.connect("config-inited", _rank)
    app.connect("source-read", _fill)
    app.connect("html-page-context", _typeset)
    app.connect("autodoc-process-signature", _leave_out_fields)
    app.connect("autodoc-process-docstring", _mark_errors)


def _rank(app: Sphinx, config: Config) -> None:
    """Let the search order pages that fit equally as the contents do."""
    contents = "".join(
        re.findall(r"```{toctree}(.*?)```", (Path(app.srcdir) / "index.md").read_text(), re.S)
    )
    scorer = Path(app.doctreedir) / "scorer.js"
    scorer.parent.mkdir(parents=True, exist_ok=True)
    rules = (Path(app.srcdir) / "scorer.js").read_text()
    scorer.write_text(f"const PAGES = {re.findall(r'^[a-z_/]+$', contents, re.M)};\n{rules}")
    config.html_search_scorer = str(scorer)


def _fill(app: Sphinx, page: str, source: list[str]) -> None:
    source[0] = generate.fill(source[0])


def _typeset(app: Sphinx, page: str, template: str, context: dict[str, str], *_: object) -> None:
    """Set θ̂_R with its index; let a command break before an option (``pages.css``)."""
    parts = re.split(
        r'(<div class="highlight-(?:sh|console).*?</pre>)', context.get("body", ""), flags=re.S
    )
    parts[1::2] = [
        re.sub(r"(?<=[ >])--?[a-z][\w-]*", r'<span class="option">\g<0></span>', p)
        for p in parts[1::2]
    ]
    # A long key breaks behind a point or an underscore.
    parts[::2] = [
        re.sub(
            r'(?<=<span class="pre">)[\w.]{16,}(?=</span>)',
            lambda key: re.sub(r"(?<=[._])", "<wbr>", key[0]),
            p,
        )
        for p in parts[::2]
    ]
    context["body"] = "".join(parts).replace("θ̂_R", "θ̂<sub>R</sub>")


def _mark_errors(
    app: Sphinx, what: str, name: str, value: object, options: object, lines: list[str]
) -> None:
    """Turn the section of a docstring that lists what is raised into fields, as Sphinx has them."""
    if "Raises:" not in lines:
        return
    start = lines.index("Raises:")
    for index in range(start + 1, len(lines)):
        error, colon, words = lines[index].strip().partition(": ")
        if lines[index].startswith("    ") and lines[index][4:5].strip() and colon:
            lines[index] = f":raises {error}: {words}"
    lines[start] = ""


def _leave_out_fields(
    app: Sphinx, what: str, name: str, value: object, *_: object
) -> tuple[str, None] | None:
    """Show settings without a signature, which would repeat the table of their fields."""
    if what == "class" and isinstance(value, type) and issubclass(value, BaseModel):
        return "", None
    return None
