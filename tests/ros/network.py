"""Two machines of their own on this one, with a switch between them."""

import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


@contextmanager
def network() -> Iterator[tuple[tuple[str, ...], tuple[str, ...], Callable[[str], object]]]:
    """Yield how commands enter two machines, and what turns the switch between them down or up."""
    if shutil.which("unshare") is None or shutil.which("ip") is None:
        pytest.skip("this machine has no unshare or ip")
    own, machine = ["unshare", "-Urn"], ["unshare", "-n"]
    if subprocess.run([*own, "true"], capture_output=True).returncode != 0:
        pytest.skip("this machine allows no network of one's own")
    holders, enters = list[subprocess.Popen[bytes]](), list[tuple[str, ...]]([()])
    for command in (own, machine, machine):
        holder = subprocess.Popen([*enters[min(len(holders), 1)], *command, "sleep", "infinity"])
        while Path(f"/proc/{holder.pid}/comm").read_text() != "sleep\n":  # it enters first
            time.sleep(0.05)
        holders.append(holder)
        enters.append(entering(holder.pid))
    del enters[0]

    def ip(at: int, words: str) -> None:
        subprocess.run([*enters[at], "ip", *words.split()], check=True)

    try:
        ip(0, "link add switch0 type bridge")
        for at in (1, 2):
            ip(0, f"link add port{at} type veth peer name eth0 netns {holders[at].pid}")
            ip(0, f"link set port{at} master switch0 up")
            ip(at, f"address add 10.9.0.{at}/24 dev eth0")
            ip(at, "link set eth0 up")
            ip(at, "link set lo up")
            ip(at, "route add default dev eth0")
        ip(0, "link set switch0 up")
        yield enters[1], enters[2], lambda state: ip(0, f"link set switch0 {state}")
    finally:
        for holder in holders:
            holder.kill()
            holder.wait()


def entering(process: int) -> tuple[str, ...]:
    return ("nsenter", "-t", str(process), "-U", "-n", "--preserve-credentials")
