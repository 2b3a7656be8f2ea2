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
    "inspect config --describe": "is now: flipperctl explain KEY",
    "inspect results": "is now: flipperctl compare DIR...",
    "eval --map": "is now: flipperctl map POLICY --over SETTINGS",
    "eval --replay": "is now: flipperctl replay FILE",
    **{
        f"{command} {option}": _INTERVALS
        for command in ("eval", "compare")
        for option in ("--detect", "--detect-success")
    },
    "eval eval.static_bound": "is gone; leave it out",
    **{
        f"bench {name}": f"is now: python -m benchmarks {name}, in a clone of the repository"
        for name in (
            *("engines", "learner", "latency", "scaling", "physics", "accuracy", "lookahead"),
            *("solve", "startup"),
        )
    },
    **{
        f"bench bench.{name}": "is gone; python -m benchmarks in a clone of the repository has it"
        for name in (
            *("repeats", "seed", "controller", "episodes", "families", "updates", "batch_sizes"),
            *("transitions", "calls", "decisions", "workers"),
        )
    },
    **{
        f"train experiment={name}": f"is now: {settings}"
        for name, settings in {
            "taught_annealed": "experiment=taught teacher.weight_end=0",
            "taught_imitation": "experiment=taught teacher.td_weight=0",
            "taught_margin": "experiment=taught teacher.loss=margin",
            "taught_td": "experiment=taught teacher.weight=0 teacher.weight_end=0",
            "generalist_first": "experiment=generalist",
        }.items()
    },
    "eval generalist_first": "is gone; flipperctl eval generalist",
}


def check_moved(command_path: str, word: str) -> None:
    """Refuse a command, an option or a setting that an earlier version had."""
    name = " ".join([*command_path.split()[1:], word])
    if name in _MOVED:
        raise RequestError(f"{name} {_MOVED[name]}")
