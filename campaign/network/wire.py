"""A bad link as a program: both ends of its connections are in one network, and their packets pass by here.

    with Wire("arm") as wire:                   # in a network of its own, see `in_own_network`
        listen(wire.near, port)                 # the server
        connect(wire.far, port)                 # its client
        wire.set(Link(delay=0.02, loss=0.01))   # from now on, in each direction

The program `python -m campaign.network.wire NAME ADDRESS SEED` reads a link as JSON from each line of its input.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import os
import selectors
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from campaign.network.link import Link, Way, direction, exchanged
from campaign.network.tun import Tun
from tools.own_network import bring_up

ROOT = Path(__file__).parents[2]
NETWORKS = {"arm": "127.77.1.", "leap": "127.77.2.", "ros": "10.77.3.", "afar": "127.77.4."}
"""Beginnings of the addresses. Simulated devices listen on loopback addresses only; ROS takes those for 127.0.0.1."""


class Wire:
    """The program, until `close`. `name`: of NETWORKS; `near`: address to listen on; `far`: where clients reach it.
    Raises OSError: this process may not make a network device."""

    def __init__(self, name: str, seed: int = 0) -> None:
        self.name = name
        self.near, self.far = (f"{NETWORKS[name]}{number}" for number in (1, 2))
        command = (sys.executable, "-m", "campaign.network.wire", f"wire_{name}", self.near, str(seed))
        self._process = subprocess.Popen(
            command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        answer = self._process.stdout.readline().strip()
        if answer != "ready":
            self.close()
            raise OSError(f"There is no bad network here: {answer or 'its program ended'}.")

    def set(self, link: Link) -> dict[str, int]:
        """Changes the link; returns how many packets came and how many were lost on it since the change before."""
        fields = {key: value for key, value in dataclasses.asdict(link).items() if value != math.inf}
        self._process.stdin.write(json.dumps(fields) + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def close(self) -> None:
        """Ends the program; its addresses are gone."""
        self._process.stdin.close()
        self._process.wait(10.0)
        self._process.stdout.close()

    def __enter__(self) -> Wire:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def in_own_network(command: Sequence[str]) -> list[str]:
    """Returns the command for a process that has a network of its own, in which it may make devices."""
    return ["unshare", "--net", "--map-root-user", *command]


def run(tun: Tun, ways: tuple[Way, Way]) -> None:
    """Passes packets on, and follows the lines of the input until it ends."""
    packets, lost, rest = 0, 0, b""
    with selectors.DefaultSelector() as selector:
        selector.register(tun, selectors.EVENT_READ)
        selector.register(sys.stdin, selectors.EVENT_READ)
        while True:
            wait = min(way.due() for way in ways) - time.monotonic()
            for key, _ in selector.select(None if math.isinf(wait) else max(wait, 0.0)):
                if key.fileobj is tun:
                    packets += _receive(tun, ways)
                    continue
                data = os.read(0, 65536)
                if not data:
                    return
                *lines, rest = (rest + data).split(b"\n")
                for line in lines:
                    ways[0].link = ways[1].link = Link(**json.loads(line))
                    lost_now = ways[0].lost + ways[1].lost
                    print(json.dumps({"packets": packets, "lost": lost_now - lost}), flush=True)
                    packets, lost = 0, lost_now
            now = time.monotonic()
            for way in ways:
                for packet in way.take(now):
                    with contextlib.suppress(OSError):  # no room: the packet is lost
                        tun.write(packet)


def _receive(tun: Tun, ways: tuple[Way, Way]) -> int:
    count = 0
    while (packet := tun.read()) is not None:
        which = direction(packet)
        if which is not None:
            ways[which].put(exchanged(packet), time.monotonic())
            count += 1
    return count


def main(name: str, near: str, seed: int) -> None:
    """The program."""
    try:
        bring_up()
        tun = Tun(name, near)
    except OSError as error:
        print(error, flush=True)
        return
    print("ready", flush=True)
    run(tun, (Way(2 * seed), Way(2 * seed + 1)))


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
