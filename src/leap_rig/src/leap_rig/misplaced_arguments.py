"""What to say about arguments of demo.launch that do not go with the number of arms."""

from __future__ import annotations

from collections.abc import Sequence


def sentence(robots: int, arguments: Sequence[str]) -> str:
    """Returns why nothing was started; `arguments` are words of those that have no effect, as name:=value."""
    names = " ".join(arguments)
    if robots == 2:
        return f"robots:=2 does not go with {names}, which is for one arm; leave it out. Nothing was started."
    return f"{names} needs two arms: add robots:=2, or leave it out. Nothing was started."
