"""Where the numbers of a report come from: policies, versions, conditions and commands.

In: a folder that ``eval --output`` wrote. Out: the report's last section.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from html import escape
from pathlib import Path

from flipperctl.evaluation import store
from flipperctl.process.session import command
from flipperctl.text.show import Column, Table, html
from flipperctl.views.summary import Document, named, shown_names


def origin(folder: Path, document: Document, marks: Mapping[str, str]) -> str:
    """Return what the numbers of a report come from, as HTML.

    ``folder``: the results; ``document``: their summary; ``marks``: colour of each policy's name.
    """
    # The stored blocks say which policies and versions the numbers come from.
    headers = [
        header
        for header in store.headers(folder / store.FOLDER)
        if header["conditions_hash"]
        in {scene["conditions"]["hash"] for scene in document["scenes"]}
    ]
    # Versions and commits, each once
    versions: dict[str, dict[str, None]] = {}
    for header in headers:
        for name, version in header.get("versions", {}).items():
            versions.setdefault(name, {})[str(version)] = None
    facts = {name: " and ".join(values) for name, values in versions.items()}
    if commits := dict.fromkeys(str(h["commit"]) for h in headers if h.get("commit")):
        facts["commit"] = " and ".join(commits)
    # Policies by the digest of their weights or settings, and scenes with their conditions
    methods = {s["controller"]: s["method"] for s in document["scenes"] if s.get("method")}
    labels = [methods.get(header["controller"], header["controller"]) for header in headers]
    called = shown_names(document)
    order = {policy: place for place, policy in enumerate(marks)}
    policies = sorted(
        {
            (called.get(label, label), header["training_seed"], header["policy"])
            for label, header in zip(labels, headers, strict=True)
        },
        key=lambda policy: (order.get(policy[0], len(order)), policy[1] or 0, policy[2]),
    )
    played = Table(
        (
            Column("policy", "policy", named=True),
            Column("seed", "training seed", named=True),
            Column("digest", "SHA-256 of the file or settings", named=True),
        ),
        [
            {"policy": name, "seed": "–" if seed is None else str(seed), "digest": digest}
            for name, seed, digest in policies
        ],
    )
    places = Table(
        tuple(
            Column(key, heading, named=True)
            for key, heading in (
                ("scene", "scene"),
                ("conditions", "conditions, hash"),
                ("engine", "engine"),
                ("seed", "seed"),
                ("episodes", "episodes"),
            )
        ),
        list(
            {
                (name, scene["seed"]): {
                    "scene": name,
                    "conditions": f"{scene['conditions']['name']} {scene['conditions']['hash']}",
                    "engine": scene["conditions"]["sim"]["name"],
                    "seed": str(scene["seed"]),
                    "episodes": str(scene["episodes"]),
                }
                for name, scene in named(document)
            }.values()
        ),
    )
    # The commands that repeat the results and this page
    commands = [
        *([document["command"]] if "command" in document else []),
        command("report", folder),
    ]
    listed = "".join(
        f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in facts.items()
    )
    return "\n".join(
        [
            *map(typed, commands),
            f"<dl>{listed}</dl>",
            html(played, marks),
            html(places, {}),
            '<p class="note">Equal hashes of the conditions mean equal scenes; with equal seeds '
            "every policy meets the same ground, start and physics.</p>",
        ]
    )


def typed(line: str) -> str:
    """Return a command as HTML, which breaks before an option and not within."""
    text = re.sub(r"(?<= )--?[a-z][\w-]*", r'<span class="option">\g<0></span>', escape(line))
    return f"<pre>{text}</pre>"
