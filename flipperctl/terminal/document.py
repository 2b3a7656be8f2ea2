"""Print results on standard output: one JSON document with ``--json``, else tables."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable

from flipperctl.terminal.streams import document_stream


def show(document: object, tables: Callable[[], None], *, as_json: bool) -> None:
    """Print ``document``, plain data, as JSON, or call ``tables`` to print the tables."""
    if as_json:
        print(json.dumps(document, indent=2), file=document_stream(), flush=True)
    else:
        tables()
        sys.stdout.flush()
