"""What commands of one scene share: the policy on it, and a player that keeps its episodes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from flipperctl.checkpoint.results import ResultFolder
from flipperctl.errors import RequestError
from flipperctl.evaluation.plan import Entry, entrants, split_policies
from flipperctl.evaluation.play import Player
from flipperctl.requests.plan import scenes
from flipperctl.requests.text import from_words
from flipperctl.terminal.streams import print_note


def one_scene(words: Sequence[str] | None, command: str) -> Entry:
    """Return the policy that the words name, on the only scene."""
    names, settings = split_policies(words)
    policies = entrants(names, print_note)
    if len(policies) != 1:
        listed = ", ".join(names) or "none"
        raise RequestError(
            f"{command} takes one policy, as in: flipperctl {command} generalist terrain=stair; "
            f"{listed} is given"
            if len(policies) < 2
            else f"{command} takes one policy; {listed} are given"
        )
    (policy,) = policies
    requests = from_words(settings)
    if any(request.key == "suite" for request in requests):
        raise RequestError(f"suite=…: {command} takes one scene; leave it out")
    played = scenes(requests, policy.run, policy.controller)
    if len(played) != 1:
        raise RequestError(f"{command} takes one scene; the settings give {len(played)}")
    return Entry(*played[0])


@contextmanager
def player(
    output: Path | None, command: str, names: Sequence[str] = ()
) -> Iterator[tuple[Player, ResultFolder | None]]:
    """Yield a player whose episodes are kept below ``output``, and that folder, if it is given.

    ``names`` are those of the files that ``command`` writes. Ctrl-C ends the running episode first.
    """
    from flipperctl.checkpoint.results import result_folder
    from flipperctl.evaluation.store import FOLDER, EpisodeStore, FolderStore
    from flipperctl.process.session import interrupts
    from flipperctl.terminal.progress import episodes_progress

    with ExitStack() as stack:
        store, folder = EpisodeStore(), None
        if output is not None:
            folder = stack.enter_context(result_folder(output, command, names))
            store = FolderStore(output / FOLDER, print_note)
        stop = stack.enter_context(interrupts("finishing the episode; Ctrl-C again stops at once"))
        yield stack.enter_context(Player(store, episodes_progress, stop)), folder
