"""Cases judged in forked children, so that a hang, a crash or a memory blow-up is one finding.

In: a number of cases and a function that judges one. Out: a verdict and its words for each.
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

Judge = Callable[[int], str]
"""Judges a case: ``equal``, ``other`` or ``silent``; raises what its entry point raises."""
Verdict = tuple[str, str]
"""``refused``, ``equal``, ``other``, ``silent``, ``traceback``, ``noise``, ``hang``; and words."""

EXPECTED = "was exported by flipperctl 0.1"
"""The one line that a whole file may cause on stderr."""


def judged(
    count: int, judge: Judge, *, limit: float = 20.0, memory: int = 3 << 30
) -> Iterator[Verdict]:
    """The verdict of each case.

    ``limit`` bounds the time of a case [s], ``memory`` what a child takes beyond today's [B].
    """
    done = 0
    while done < count:
        receive, send = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(receive)
            _work(range(done, count), judge, os.fdopen(send, "w"), memory)
        os.close(send)
        for line in _lines(receive, limit):
            if line is None:
                os.kill(child, signal.SIGKILL)
                yield "hang", f"no verdict within {limit:g} s"
                done += 1
                break
            verdict, words = json.loads(line)
            yield verdict, words
            done += 1
        os.close(receive)
        status = os.waitpid(child, 0)[1]
        if done < count and os.WIFSIGNALED(status) and os.WTERMSIG(status) != signal.SIGKILL:
            yield "traceback", f"the process died by signal {os.WTERMSIG(status)}"
            done += 1


def _lines(receive: int, limit: float) -> Iterator[bytes | None]:
    """Lines as they come; None when none comes in time."""
    rest = b""
    while select.select([receive], [], [], limit)[0]:
        data = os.read(receive, 1 << 16)
        if not data:
            return
        *lines, rest = (rest + data).split(b"\n")
        yield from lines
    yield None


def _work(cases: range, judge: Judge, out: IO[str], memory: int) -> None:
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + memory, used + memory))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    heard = [tempfile.TemporaryFile() for _ in range(2)]  # noqa: SIM115 - until the process ends
    for number, file in enumerate(heard, start=1):
        os.dup2(file.fileno(), number)
    sys.stdout, sys.stderr = os.fdopen(1, "w", closefd=False), os.fdopen(2, "w", closefd=False)
    warnings.simplefilter("error")
    warnings.simplefilter("ignore", PendingDeprecationWarning)
    for case in cases:
        verdict = _verdict(case, judge)
        sys.stdout.flush()
        sys.stderr.flush()
        said = []
        for file in heard:
            file.seek(0)
            said.append(file.read().decode(errors="replace"))
            file.seek(0)
            file.truncate()
        noise = said[0] + "".join(x for x in said[1].splitlines(True) if EXPECTED not in x)
        if noise and verdict[0] in ("refused", "equal", "other"):
            verdict = "noise", noise
        out.write(json.dumps((verdict[0], verdict[1][:600])) + "\n")
        out.flush()
    os._exit(0)


def _verdict(case: int, judge: Judge) -> Verdict:
    try:
        return judge(case), ""
    except FlipperctlError as error:
        text = str(error)
        if error.exit_code != 2 or text.count("\n") > 1 or not text.replace("\n", "").isprintable():
            return "traceback", f"exit code {error.exit_code}: {text!r}"
        return "refused", text
    except BaseException:  # noqa: BLE001 - whatever comes is what the fuzz looks for
        return "traceback", traceback.format_exc()[-600:]
