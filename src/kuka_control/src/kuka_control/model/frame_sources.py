"""Who publishes which frame of tf: one that two nodes publish jumps between what both of them say.

Time is monotonic, in seconds. After one node has exited, another one may publish the frame, but not at once.
"""

from __future__ import annotations

from dataclasses import dataclass

HANDOVER_S = 1.0
"""Another node may take over a frame after the one before has been silent for this long [s]."""


@dataclass(frozen=True)
class Conflict:
    """A frame that several nodes published, the last time at `when`."""

    frame: str
    nodes: tuple[str, ...]
    when: float

    def __str__(self) -> str:
        return f"{' and '.join(self.nodes)} both publish {self.frame}; end one of them"


class FrameSources:
    """Knows who published which frame lately, and in which other frame it stands."""

    def __init__(self) -> None:
        self._heard: dict[str, dict[str, float]] = {}
        self._parents: dict[str, str] = {}
        self._conflicts: dict[str, Conflict] = {}

    def heard(self, frame: str, parent: str, node: str, now: float) -> bool:
        """Takes note of who published a frame; returns whether nobody else did lately."""
        self._parents[frame] = parent
        times = {name: then for name, then in self._heard.get(frame, {}).items() if now - then < HANDOVER_S}
        times[node] = now
        self._heard[frame] = times
        if len(times) > 1:
            self._conflicts[frame] = Conflict(frame, tuple(sorted(times)), now)
        return len(times) == 1

    def conflict(self, frame: str, now: float) -> Conflict | None:
        """Returns the conflict about `frame` or about one of those that it stands in, directly or not; else None."""
        passed = set()
        while frame not in passed:
            found = self._conflicts.get(frame)
            if found is not None and now - found.when < HANDOVER_S:
                return found
            passed.add(frame)
            frame = self._parents.get(frame, frame)
        return None
