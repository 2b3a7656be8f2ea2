"""What methods are called in tables and figures: by the user, or by what tells them apart.

In: labels such as ``runs/cmp/network=mlp``, and the words of ``--name``. Out: short names.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import PurePath

from flipperctl.errors import RequestError
from flipperctl.text.messages import unknown

_FILES = re.compile(r"/checkpoints/(best|last)\.safetensors$")
_JOB = re.compile(r"^\d+_(?=[^/]*=)")


def names(labels: Sequence[str]) -> dict[str, str]:
    """Return a short name for each label; no two names are equal.

    A path is called by the shortest ends that are unique. A folder of a sweep is called by the
    values of its settings. The last part of a key comes before a value that is a number, and the
    seed only where it is needed.
    """
    whole = {label: _FILES.sub("", label) for label in labels}
    # Take more parts of the paths until all names differ, and seeds only where they must be told.
    for count in range(1, max([1, *(text.count("/") + 1 for text in whole.values())]) + 1):
        for with_seed in (False, True):
            shortened = {label: _last(text, count, with_seed) for label, text in whole.items()}
            if len(set(shortened.values())) == len(shortened):
                return shortened
    return whole


def _last(text: str, count: int, with_seed: bool) -> str:
    """Return the last parts of a path; settings in the last part are shortened to their values."""
    *folders, last = text.split("/")
    parts: list[str] = []
    for part in map(str.strip, _JOB.sub("", last).split(",")):
        key, equals, value = part.partition("=")
        if key == "seed" and (parts or folders) and not with_seed:
            continue
        name = key.rpartition(".")[2]
        plain = not equals or name == "seed" or re.fullmatch(r"[-+.\deE]+|true|false|null", value)
        parts.append(f"{name}={value}" if equals and plain else value if equals else part)
    if not parts:  # a sweep of seeds alone is called by its folder
        parts.append(folders.pop())
    return "/".join([*folders[len(folders) - count + 1 :], ", ".join(parts)])


def chosen_names(words: Sequence[str], labels: Sequence[str]) -> dict[str, str]:
    """Return the names of ``NAME=METHOD`` by the labels that they stand for.

    A METHOD is a label, its short name, or the last parts of its path.

    Raises:
        RequestError: a word has no such form, or fits no label or several.
    """
    short, by_label = names(labels), dict[str, str]()
    for word in words:
        name, equals, method = word.partition("=")
        if not (name.strip() and equals and method):
            raise RequestError(f"--name {word}: NAME=METHOD is allowed, as in AT-D3QN=runs/first")
        wanted = PurePath(method).parts
        # A word may name a label, its short name, or the end of its path.
        fits = [
            label
            for label in labels
            if method in (label, short[label])
            or PurePath(_FILES.sub("", label)).parts[-len(wanted) :] == wanted
        ]
        if not fits:
            text = unknown(f"--name {word}: there is no method", method, short.values())
            raise RequestError(text)
        if len(fits) > 1 and method not in fits:
            raise RequestError(f"--name {word}: {method} fits several: {', '.join(fits)}")
        by_label[method if method in fits else fits[0]] = name.strip()
    return by_label


def renamed(labels: Sequence[str], words: Sequence[str]) -> dict[str, str]:
    """Return what each label is called: by ``NAME=METHOD``, else its short name.

    Raises:
        RequestError: see ``chosen_names``; or two methods have one name.
    """
    by_label = {**names(labels), **chosen_names(words, labels)}
    for label, name in by_label.items():
        if alike := [other for other in by_label if other != label and by_label[other] == name]:
            raise RequestError(f"--name: {label} and {alike[0]} would both be called {name}")
    return by_label


def taken(label: str, called: Mapping[str, str], option: str, further: Sequence[str] = ()) -> str:
    """Return the label that a user's text names: a label, or what it is ``called``.

    Raises:
        RequestError: there is none; ``further`` words are known as well.
    """
    by_name = {name: candidate for candidate, name in called.items()}
    if label not in called and label not in by_name:
        raise RequestError(unknown(f"{option}: there is no method", label, [*by_name, *further]))
    return label if label in called else by_name[label]
