"""Cases run in forked children, so that a hang, a crash or a lack of memory ends one case only.

In: a number of cases and a function that checks one. Out: a verdict with its text for each.
"""

import json
import os
import resource
import select
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

from flipperctl.errors import FlipperctlError

Check = Callable[[int], str]
"""Runs a case and returns ``equal``, ``other`` or ``silent``; raises the errors of the case."""
Verdict = tuple[str, str]
"""``refused``, ``equal``, ``other``, ``silent``, ``traceback``, ``noise``, ``hang``; and a text."""


def run_isolated(
    count: int, check: Check, *, limit: float = 20.0, memory: int = 3 << 30
) -> Iterator[Verdict]:
    """Yield the verdict of each case, in order.

    ``limit``: longest time of a case [s]. ``memory``: address space that a child may use beyond
    that of this process [B].
    """
    done = 0
    while done < count:
        receive, send = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(receive)
            _run_child(range(done, count), check, os.fdopen(send, "w"), memory)
        os.close(send)
        for line in _lines(receive, limit):
            if line is None:
                os.kill(child, signal.SIGKILL)
                yield "hang", f"no verdict within {limit:g} s"
                done += 1
                break
            verdict, text = json.loads(line)
            yield verdict, text
            done += 1
        os.close(receive)
        status = os.waitpid(child, 0)[1]
        if done < count and os.WIFSIGNALED(status) and os.WTERMSIG(status) != signal.SIGKILL:
            yield "traceback", f"the process died by signal {os.WTERMSIG(status)}"
            done += 1


def _lines(receive: int, limit: float) -> Iterator[bytes | None]:
    """Yield the lines from a pipe as they come, and None when none comes within ``limit`` [s]."""
    rest = b""
    while select.select([receive], [], [], limit)[0]:
        data = os.read(receive, 1 << 16)
        if not data:
            return
        *lines, rest = (rest + data).split(b"\n")
        yield from lines
    yield None


def _run_child(cases: range, check: Check, out: IO[str], memory: int) -> None:
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + memory, used + memory))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    captured = [tempfile.TemporaryFile() for _ in range(2)]  # noqa: SIM115 - until the process ends
    for number, file in enumerate(captured, start=1):
        os.dup2(file.fileno(), number)
    sys.stdout, sys.stderr = os.fdopen(1, "w", closefd=False), os.fdopen(2, "w", closefd=False)
    warnings.simplefilter("error")
    warnings.simplefilter("ignore", PendingDeprecationWarning)
    for case in cases:
        verdict = _verdict(case, check)
        sys.stdout.flush()
        sys.stderr.flush()
        printed = []
        for file in captured:
            file.seek(0)
            printed.append(file.read().decode(errors="replace"))
            file.seek(0)
            file.truncate()
        noise = "".join(printed)
        if noise and verdict[0] in ("refused", "equal", "other"):
            verdict = "noise", noise
        out.write(json.dumps((verdict[0], verdict[1][:600])) + "\n")
        out.flush()
    os._exit(0)


def _verdict(case: int, check: Check) -> Verdict:
    try:
        return check(case), ""
    except FlipperctlError as error:
        text = str(error)
        if error.exit_code != 2 or text.count("\n") > 1 or not text.replace("\n", "").isprintable():
            return "traceback", f"exit code {error.exit_code}: {text!r}"
        return "refused", text
    except BaseException:  # noqa: BLE001 - the fuzz looks for any other error
        return "traceback", traceback.format_exc()[-600:]
