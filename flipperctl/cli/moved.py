"""Commands, options and settings of earlier versions, and what is typed in their place."""

from __future__ import annotations

from flipperctl.errors import RequestError

_ENGINES = "is now: flipperctl eval POLICY sim=planar,mujoco"
_INTERVALS = "is gone; flipperctl compare DIR... gives the 95 % interval of each difference"
_MOVED = {
    "transfer": _ENGINES,
    "inspect engines": _ENGINES,
    "inspect conventions": (
        "is now: flipperctl inspect plugins --check, or inspect checkpoint FILE --check of a policy"
    ),
    "convert": "is now: flipperctl robot ground BAG --output FILE.xyz",
    "shadow": "is now: flipperctl robot shadow POLICY BAG",
    "inspect perception": "is now: flipperctl robot check BAG",
    "inspect results": "is now: flipperctl compare DIR...",
    "eval --map": "is now: flipperctl map POLICY --over SETTINGS",
    "eval --replay": "is now: flipperctl replay FILE",
    **{
        f"{command} {option}": _INTERVALS
        for command in ("eval", "compare")
        for option in ("--detect", "--detect-success")
    },
    "eval eval.static_bound": "is gone; leave it out",
}


def check_moved(command_path: str, word: str) -> None:
    """Refuse a subcommand, an option or a key of ``flipperctl …`` that an earlier version had.

    Raises:
        RequestError: it has moved; the text says what to type.
    """
    name = " ".join([*command_path.split()[1:], word])
    if name in _MOVED:
        raise RequestError(f"{name} {_MOVED[name]}")
