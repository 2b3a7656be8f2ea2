"""Signals of schedulers and terminals stop a run at the next safe point, as Ctrl-C does."""

import os
import signal
from collections.abc import Iterator

import pytest

from flipperctl.rollout.worker import STOPS
from flipperctl.session import interrupts

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


@pytest.mark.parametrize("number", REPEATED)
def test_a_signal_that_is_sent_repeatedly_interrupts_nothing(number: signal.Signals) -> None:
    """A terminal that closes sends SIGHUP twice, and the limit of CPU time SIGXCPU each second."""
    with interrupts("saving …") as stop:
        for sent in (number, number, signal.SIGTERM):  # a scheduler's warning, then its first stop
            os.kill(os.getpid(), sent)
        assert stop()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.parametrize("number", REPEATED)
def test_what_the_caller_ignores_or_handles_stays_so(number: signal.Signals) -> None:
    received: list[int] = []
    with interrupts("saving …") as stop:
        pass
    for handler in (signal.SIG_IGN, lambda number, frame: received.append(number)):
        signal.signal(number, handler)
        with interrupts("saving …") as stop:
            os.kill(os.getpid(), number)
            assert not stop()
    assert received == [number]
