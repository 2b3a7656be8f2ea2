"""Policies of the Hugging Face Hub: ``hf:user/name`` or ``hf:user/name@revision``.

In: such a word, or a policy's file and its card. Out: the file in the Hub's cache, or a commit. It
is a .safetensors file, which holds no code. Needs the extra ``hub``, which is imported on use.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

from flipperctl.errors import CheckpointError, RequestError, missing_extra

PREFIX = "hf:"
FILE = "policy.safetensors"
"""Name of the policy in a repository; without it, the only .safetensors file is taken."""
LIMIT = 2**28
"""Largest file that is downloaded or uploaded [bytes]."""
_REPOSITORY = re.compile(r"[\w.-]+/[\w.-]+", re.ASCII)


@cache
def download(word: str) -> Path:
    """Return the file that ``hf:user/name[@revision]`` names, once in a process.

    Without a network, the file of an earlier download is returned.

    Raises:
        CheckpointError: There is no such repository, revision or policy, or no network.
        MissingExtraError: huggingface_hub is not installed.
    """
    repository, at, revision = word.removeprefix(PREFIX).partition("@")
    if not _REPOSITORY.fullmatch(repository) or (at and not revision):
        raise CheckpointError(f"{word}: write hf:user/name or hf:user/name@revision")
    hub, reference = _hub(word), revision or "main"
    api = hub.HfApi()
    # The list of files names the policy and its size before anything is downloaded.
    try:
        info = api.model_info(repository, revision=reference, files_metadata=True)
        sizes = {sibling.rfilename: sibling.size or 0 for sibling in info.siblings or ()}
        name = _policy_name(word, sizes)
        return Path(api.hf_hub_download(repository, name, revision=reference))
    except RequestError:
        raise
    except Exception as error:  # of whichever HTTP client huggingface_hub has
        # Without a network an earlier download will do; a refusal by the Hub is final.
        if not isinstance(error, hub.errors.HfHubHTTPError):
            cached = hub.try_to_load_from_cache(repository, FILE, revision=reference)
            if isinstance(cached, str):
                return Path(cached)
        raise CheckpointError(f"{word}: {_reason(hub, error)}") from error


def _policy_name(word: str, sizes: dict[str, int]) -> str:
    """Return the name of the policy among a repository's files, name → bytes."""
    policies = [name for name in sizes if name.endswith(".safetensors")]
    name = FILE if FILE in policies else policies[0] if len(policies) == 1 else ""
    if not name:
        names = ", ".join(sorted(policies)) or "none"
        raise CheckpointError(
            f"{word}: the repository needs {FILE} or a single .safetensors file; it has {names}"
        )
    _check_size(f"{word}: {name}", sizes[name])
    return name


def _check_size(name: str, size: int) -> None:
    if size > LIMIT:
        raise CheckpointError(
            f"{name} has {size / 2**20:,.0f} MiB; at most {LIMIT // 2**20} MiB are allowed"
        )


def label(file: Path) -> str | None:
    """Return ``hf:user/name`` for a file in the Hub's cache, with ``@revision`` if not main's."""
    # The cache has models--USER--NAME/snapshots/COMMIT/FILE, and a file for each branch in refs.
    if len(file.parts) < 4 or file.parts[-3] != "snapshots":
        return None
    home, commit = file.parents[2], file.parts[-2]
    kind, *names = home.name.split("--")
    if kind != "models" or len(names) != 2:
        return None
    word, refs = PREFIX + "/".join(names), home / "refs"
    at = {ref.read_text(): str(ref.relative_to(refs)) for ref in refs.rglob("*") if ref.is_file()}
    main = refs / "main"
    if main.is_file() and main.read_text() == commit:
        return word
    return f"{word}@{at.get(commit, commit)}"


def push(repository: str, file: Path, card: str) -> str:
    """Upload a policy with its card as README.md, in one commit; return the commit's address.

    Raises:
        RequestError: The name is wrong, no token is known, or the Hub refuses.
        MissingExtraError: huggingface_hub is not installed.
    """
    where = f"--push {repository}"
    if not _REPOSITORY.fullmatch(repository):
        raise RequestError(f"{where}: write user/name")
    hub = _hub(where)
    if hub.get_token() is None:
        raise RequestError(f"{where}: no token of the Hub is known; hf auth login, or set HF_TOKEN")
    # What can be refused here is refused before a repository is created.
    _check_size(str(file), file.stat().st_size)
    added = {FILE: str(file), "README.md": card.encode()}
    operations = [hub.CommitOperationAdd(name, content) for name, content in added.items()]
    api, message = hub.HfApi(), "flipperctl card --push"
    try:
        api.create_repo(repository, exist_ok=True)
        return str(api.create_commit(repository, operations, commit_message=message).commit_url)
    except Exception as error:  # as above
        raise RequestError(f"{where}: {_reason(hub, error)}") from error


def _reason(hub: Any, error: Exception) -> str:
    """Return why a request failed, in one line."""
    if isinstance(error, hub.errors.RepositoryNotFoundError):
        return "the Hub has no such repository, or it is private; hf auth login gives access"
    if isinstance(error, hub.errors.RevisionNotFoundError):
        return "the repository has no such revision"
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return f"the Hub cannot be reached or refuses: {lines[0]}"


def _hub(where: str) -> Any:
    try:
        import huggingface_hub
        import huggingface_hub.errors
    except ImportError as error:
        raise missing_extra(f"{where}: the Hub", "huggingface_hub") from error
    return huggingface_hub
