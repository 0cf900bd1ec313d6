"""Which of the many frames on /tf the desired tool frame stands in, and when a hand has come in. Pure."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

Transform = TypeVar("Transform")


class FrameChain(Generic[Transform]):
    """The frames that some frames, `ends`, stand in. Transforms of other frames are kept in case this changes, the
    newest few of each.

    Attributes:
        parents: the frame that a frame stands in."""

    def __init__(self, *ends: str) -> None:
        self.parents: dict[str, str] = {}
        self._ends = ends
        self._needed = {*ends}
        self._kept: dict[str, deque[Transform]] = {}

    def path(self, frame: str) -> list[str]:
        """Returns a frame and those that it stands in, one after the other; each once where they are a circle."""
        path: list[str] = []
        following: str | None = frame
        while following is not None and following not in path:
            path.append(following)
            following = self.parents.get(following)
        return path

    def put(self, child: str, parent: str) -> list[Transform]:
        """Takes in which frame another one stands; returns the kept transforms that are needed from now on. What was
        needed stays so: tf2 also looks at moments before a change."""
        self.parents[child] = parent
        self._needed.update(*map(self.path, self._ends))
        return [transform for frame in self._needed & self._kept.keys() for transform in self._kept.pop(frame)]

    def needs(self, child: str, transform: Transform) -> bool:
        """Returns whether the transform of a frame is needed; keeps it otherwise."""
        if child in self._needed:
            return True
        most = 32  # transforms of a frame that are kept
        self._kept.setdefault(child, deque(maxlen=most)).append(transform)
        return False

    def forget(self) -> None:
        """Forgets the transforms that are kept."""
        self._kept.clear()


class HandEntries:
    """Counts the hands that have come in. One has if the virtual Leap came without a desired tool frame before, and now
    comes with one and the filtered hand. Without that a program holds the tool."""

    def __init__(self, leap: str, tool: str, filtered: str) -> None:
        self.count = 0
        self._leap = leap
        self._tool = tool
        self._filtered = filtered
        self._without_tool = False  # whether the virtual Leap came so since the last hand

    def take(self, frames: set[str]) -> None:
        """Takes the names of the frames that came together."""
        if self._leap in frames and self._tool not in frames:
            self._without_tool = True
        elif self._leap in frames and self._filtered in frames:
            self.count += self._without_tool
            self._without_tool = False
