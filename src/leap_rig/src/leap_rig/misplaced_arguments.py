"""What to say about arguments of demo.launch that do not go with the number of arms."""

from __future__ import annotations

from collections.abc import Sequence


def sentence(robots: int, arguments: Sequence[str]) -> str:
    """Returns why nothing was started; `arguments` are words of those that would have no effect, as name:=value."""
    given = " ".join(arguments)
    if robots == 2:
        return f"Nothing was started: {given} would have no effect with robots:=2, only with one arm. Leave that out."
    return f"Nothing was started: {given} would have no effect without robots:=2. Add that, or leave this out."
