"""Ctrl-C and other signals stop a run in one line; a reader that goes away sees no traceback."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from flipperctl.errors import ConfigError
from flipperctl.process import entry
from flipperctl.process.entry import STOPS
from flipperctl.process.session import interrupts
from tests.runtime.linear import write

pytestmark = pytest.mark.slow

PROGRAMS = {
    "command": "from flipperctl.__main__ import main; main()",
    "nohup": "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); "
    "from flipperctl.__main__ import main; main()",
    "runtime": "from flipperctl.runtime.__main__ import main; main()",
    "clock": "runpy.run_module('flipperctl.commands.speed', run_name='__main__')",
}


def start(program: str, words: list[str], cwd: Path) -> subprocess.Popen[str]:
    """Start a program as its console script does, and wait until the interpreter is ready."""
    head = "import re, runpy, sys; sys.stderr.write('ready\\n'); sys.stderr.flush(); "
    process = subprocess.Popen(
        [sys.executable, "-c", head + PROGRAMS[program], *words],
        cwd=cwd, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert process.stderr is not None
    assert process.stderr.readline() == "ready\n"
    return process


def wait(process: subprocess.Popen[str], seconds: float) -> None:
    """Wait until a process has computed for so long, whatever else the machine computes.

    Before its first lines have run, Python itself answers Ctrl-C; on a busy machine these take long
    by the clock on the wall. A process that ends or waits for others is given ten seconds.
    """
    if sys.platform != "linux":
        time.sleep(seconds)
        return
    clock = (~process.pid << 3) | 2  # as clock_getcpuclockid of the C library has it
    until, begun = time.clock_gettime(clock) + seconds, time.monotonic()
    while process.poll() is None and time.monotonic() < begun + 10:
        if time.clock_gettime(clock) >= until:
            return
        time.sleep(0.001)


TRAIN = ["train", "train.decisions=100000", "train.workers=2"]
EVAL = ["eval", "--controller", "okada", "terrain=stair", "--episodes", "1000"]


@pytest.mark.parametrize("words", [["--help"], EVAL, TRAIN], ids=lambda words: words[0])
def test_ctrl_c_at_the_start_is_one_line(words: list[str], tmp_path: Path) -> None:
    process = start("command", words, tmp_path)
    wait(process, 0.2)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert "Traceback" not in err
    assert "Exception ignored" not in err
    if words == ["--help"] and process.returncode == 0:
        return  # it was quicker
    assert process.returncode in (130, -signal.SIGINT), err
    noticed = err.startswith("\n")  # once it works, a notice begins on a line of its own, behind ^C
    assert len(err.splitlines()) <= 2 + noticed, err


@pytest.mark.parametrize("program", ["runtime", "clock"])
def test_ctrl_c_in_another_program_is_one_line(program: str, tmp_path: Path) -> None:
    words = [str(write(tmp_path / "p.onnx")), *(["1000000", "0"] if program == "clock" else [])]
    process = start(program, words, tmp_path)
    wait(process, 0.1)
    process.send_signal(signal.SIGINT)
    # While a library is imported, Python may drop a first one; people press again.
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(2)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert "Traceback" not in err
    if program == "clock" or process.returncode != 0:
        assert process.returncode in (130, -signal.SIGINT), err


def test_an_error_that_a_library_made_of_ctrl_c_is_ctrl_c(
    capsys: pytest.CaptureFixture[str],
) -> None:
    handler = signal.getsignal(signal.SIGINT)

    def library() -> int:
        with contextlib.suppress(KeyboardInterrupt):  # as a library in Rust does
            signal.raise_signal(signal.SIGINT)
        raise ImportError("this package is broken")

    def request() -> int:
        try:
            return library()
        except ImportError as error:
            raise ConfigError("not understood") from error

    for program in (library, request):
        try:
            with pytest.raises(SystemExit) as left:
                entry.run(program)
        finally:
            signal.signal(signal.SIGINT, handler)
        assert left.value.code == 130
        assert capsys.readouterr().err == "error: interrupted\n"


def test_who_ignores_ctrl_c_goes_on_doing_so(tmp_path: Path) -> None:
    process = start("nohup", ["inspect", "plugins"], tmp_path)
    wait(process, 0.1)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "okada" in out


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("command", ["inspect", "plugins", "--json"]),
        ("runtime", []),
    ],
)
def test_a_reader_that_goes_away_sees_no_traceback(
    program: str, words: list[str], tmp_path: Path
) -> None:
    if program != "command":
        words = [str(write(tmp_path / "p.onnx")), *words]
    process = start(program, words, tmp_path)
    assert process.stdout is not None
    process.stdout.close()  # before it writes, so that every write fails
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1, err
    assert "Traceback" not in err
    assert "Exception ignored" not in err
    assert "Broken pipe" not in err


REPEATED = [number for number in STOPS if number not in (signal.SIGINT, signal.SIGTERM)]


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    """What the tests set is undone."""
    before = {number: signal.getsignal(number) for number in STOPS}
    for number in REPEATED:
        signal.signal(number, signal.SIG_DFL)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", STOPS)
def test_the_first_signal_asks_for_a_stop(
    number: signal.Signals, capsys: pytest.CaptureFixture[str]
) -> None:
    before = [signal.getsignal(number) for number in STOPS]
    with interrupts("saving …") as stop:
        assert not stop()
        os.kill(os.getpid(), number)
        assert stop()
    assert capsys.readouterr().err == "\nsaving …\n"
    assert [signal.getsignal(number) for number in STOPS] == before


def test_a_signal_that_is_sent_repeatedly_interrupts_nothing() -> None:
    """A terminal that closes sends SIGHUP twice, and the limit of CPU time SIGXCPU each second."""
    for number in REPEATED:
        with interrupts("saving …") as stop:
            for sent in (number, number, signal.SIGTERM):  # a scheduler's warning, then its stop
                os.kill(os.getpid(), sent)
            assert stop()
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)


def test_what_the_caller_ignores_or_handles_stays_so() -> None:
    received: list[int] = []
    number = REPEATED[0]
    for handler in (signal.SIG_IGN, lambda number, frame: received.append(number)):
        signal.signal(number, handler)
        with interrupts("saving …") as stop:
            os.kill(os.getpid(), number)
            assert not stop()
    assert received == [number]
