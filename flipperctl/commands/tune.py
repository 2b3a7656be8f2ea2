"""``flipperctl tune``: search a controller's own numeric settings, or let it learn them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flipperctl.cli import options
from flipperctl.errors import InterruptedRunError, RequestError
from flipperctl.terminal.streams import print_note, show

if TYPE_CHECKING:
    from flipperctl.evaluation import tuning


def tune(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="CONTROLLER [SETTING...]",
            help="A controller; key=value, budget=EPISODES and from=DEMONSTRATOR.",
        ),
    ] = None,
    objective: Annotated[
        str, typer.Option("--for", metavar="pitch|reward", help="What is searched for.")
    ] = "pitch",
    numbers: Annotated[
        str | None,
        typer.Option(
            "--settings", metavar="NAMES", help="Numbers to search, as in near,far; else all."
        ),
    ] = None,
    episodes: Annotated[
        str | None,
        typer.Option(metavar="N", help="Episodes of a candidate on each scene [20 / scenes]."),
    ] = None,
    seed: Annotated[
        str | None, typer.Option(metavar="N", help="Seed of the search and its episodes [0].")
    ] = None,
    jobs: options.Jobs = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The policy file [CONTROLLER_tuned.yaml].")
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Tune a controller: search its bounded numbers by CMA-ES, or let it learn its settings.

    The episodes are those of trainings; evaluations play others. All candidates of a generation
    meet the same ground, and each generation meets new ground. The best few are then compared on
    fresh episodes, beside the settings of the start, which stay unless they are beaten beyond
    chance. The score is the pitch variation. A failed episode costs 6.28 rad, and a crossing at
    most that; --for reward takes the configured rewards.

    The result is a policy file, which stands wherever a POLICY is named. budget=5000 is the default
    number of episodes. terrain=a,b and suite=NAME tune for several scenes, and controller.key=value
    chooses where the search begins. Repeat an interrupted search to resume it.

    zimmermann and hfc learn instead, and --settings searches their numbers. hfc learns from drives,
    or from a policy that plays episodes: from=drives/me, from=generalist.

    [bold]Examples[/]

      flipperctl tune okada terrain=stair --output okada_stair.yaml

      flipperctl tune okada terrain=step,stair budget=20000 --jobs 2

      flipperctl tune okada suite=families --for reward

      flipperctl tune hfc from=generalist terrain=stair
    """
    from flipperctl.config import policy_file, resolver
    from flipperctl.config.words import key_of, with_flags
    from flipperctl.evaluation import tuning
    from flipperctl.evaluation.plan import NamedPolicy, split_policies
    from flipperctl.requests.plan import make_plan
    from flipperctl.requests.text import from_words
    from flipperctl.text.files import check_output, write_bytes
    from flipperctl.text.show import console, print_table
    from flipperctl.views.tune import table

    # One controller, and the words that only tune has
    names, settings = split_policies(words)
    if len(names) != 1:
        raise RequestError(
            "tune takes one controller, as in: flipperctl tune okada terrain=stair; "
            f"{', '.join(names) or 'none'} is given"
        )
    (name,) = names
    if not policy_file.is_policy_file(name):
        resolver.get("controller", name, "tune")
    if objective not in ("pitch", "reward"):
        raise RequestError(f"--for: pitch or reward is allowed; the value is {objective!r}")
    budgets, demonstrators = (
        [word.partition("=")[2] for word in settings if key_of(word) == key]
        for key in ("budget", "from")
    )
    others = [word for word in settings if key_of(word) not in ("budget", "from")]
    if len(demonstrators) > 1:
        raise RequestError(f"from: one demonstrator is allowed; {', '.join(demonstrators)} are")
    if len(budgets) > 1 or not all(
        text.isdecimal() and 0 < int(text[:10]) < 10**9 for text in budgets
    ):
        raise RequestError(
            f"budget: one number of episodes from 1 on, below a billion, is allowed, as in "
            f"budget=5000; the value is {' '.join(budgets):.40}"
        )

    # The file is checked before the search, which takes long.
    output = output or Path(f"{Path(name).stem.removesuffix('_tuned')}_tuned.yaml")
    check_output(output, policy_file.POLICY_FILE)
    flagged = with_flags(others, episodes=episodes, seed=seed, jobs=jobs)
    entries = make_plan(from_words(flagged), [NamedPolicy(name)], "none", print_note).entries
    config = entries[0].config
    if any(entry.source != entries[0].source for entry in entries):
        raise RequestError("controller: one value of each setting is allowed, where it begins")
    if config.eval.ray is not None:
        raise RequestError("eval.ray: a search is played here; leave it out")
    if objective == "reward" and not all(entry.config.rewards for entry in entries):
        raise RequestError("--for reward: there is no reward term; leave ~rewards out")
    has_episodes = any(key_of(word) == "eval.episodes" for word in flagged)
    request = tuning.Request(
        entries,
        [word for word in settings if key_of(word) != "budget"],
        "reward" if objective == "reward" else "pitch",
        int(budgets[0]) if budgets else tuning.BUDGET,
        config.eval.seed,
        config.eval.episodes if has_episodes else None,
        None if numbers is None else [setting.strip() for setting in numbers.split(",")],
        demonstrators[0] if demonstrators else None,
    )
    request.check()

    # The search, and the file of its result
    tuned = _tune(request, output.with_suffix(".search.json"))
    file = request.policy_file(tuned)
    write_bytes(output, file.text().encode())
    document = file.model_dump(mode="json") | {"before": tuned.start, "p": tuned.p}
    show(document, lambda: print_table(table(request, tuned), console()), as_json=as_json)
    print_note(f"wrote {output}")


def _tune(request: tuning.Request, state: Path) -> tuning.Tuned:
    """Search with progress; Ctrl-C ends the running generation."""
    from flipperctl.evaluation.play import Player
    from flipperctl.process import session
    from flipperctl.terminal.progress import EvaluationProgress

    progress = EvaluationProgress()
    progress.plan(request.budget)
    size = 1

    def tell_size(episodes: int) -> None:
        nonlocal size
        size = episodes

    @contextmanager
    def shown(label: str, requests: int) -> Iterator[Callable[[float], None]]:
        with progress(label, requests * size) as report:
            yield lambda done: report(done * size)

    notice = "stopping; Ctrl-C again stops at once"
    with session.interrupts(notice) as stop, Player(None, shown, stop, training=True) as player:
        try:
            if request.learns:
                return request.learn(player, tell_size, progress, stop)
            return request.tune(player, tell_size, state)
        except InterruptedRunError as error:
            if request.learns:
                raise InterruptedRunError("interrupted; nothing was written") from error
            raise InterruptedRunError(
                f"interrupted; repeat the command to resume after the generations in {state}"
                if state.exists()
                else "interrupted before the end of the first generation"
            ) from error
