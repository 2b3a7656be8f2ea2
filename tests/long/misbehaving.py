"""What an error of a plugin that misbehaves (``odd_plugins.py``) must name."""

import re
from pathlib import Path

from tests.long.odd_plugins import BEFORE, Misbehaviour


def unnamed(what: Misbehaviour, text: str, file: Path) -> list[str]:
    """Return what the text of an error should name but does not."""
    found = []
    if not re.search(re.escape(str(file)) + r":\d+", text):
        found.append("no file and line")
    if what.spot in BEFORE:
        if what.spot != "import" and "odd" not in text.replace(str(file), ""):
            found.append("no plugin")
        return found
    if "'odd'" not in text:
        found.append("no plugin")
    methods = {"build": ("build", "forward")}.get(what.spot, (what.spot,))
    if not any(method in text for method in methods):
        found.append("no method")
    return found
