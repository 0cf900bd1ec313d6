"""Episodes of one session: when each begins and ends, what is said of it, and the file of that beside its recording.

    SESSION/episode_00000/          a recording of its own
    SESSION/episode_00000/label.yaml

What a person says counts before what the world or the taxels say; it may be changed later.
"""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from common.episode_marks import AGAIN, BEGIN, DISCARD, FAILURE, MARKS, SUCCESS
from common.errors import RigError
from common.ros.files import read_text, write_whole

DISCARDED, UNFINISHED = "discarded", "unfinished"
OUTCOMES = SUCCESS, FAILURE, DISCARDED, UNFINISHED
SAID = {SUCCESS: SUCCESS, FAILURE: FAILURE, DISCARD: DISCARDED}
"""The outcome that a mark gives an episode."""
COUNTED, BEGUN, ENDED, LABELLED = "counted", "begun", "ended", "labelled"
LABEL = "label.yaml"
FOLDER = re.compile(r"episode_(\d{5})")
SCHEMA = 1


class EpisodeFault(RigError):
    """A mark does not fit, or a label cannot be read; the text is a sentence."""


class EpisodeChange(NamedTuple):
    """What happened: `COUNTED` with the seconds left, else to the episode of this number."""

    what: str
    number: int
    outcome: str = ""  # as said; empty where nobody said one


class EpisodeSession:
    """Begins and ends episodes by marks; the first gets the number `first`, each begins `countdown` seconds after its
    mark and ends by itself after `longest` seconds, without an outcome. Times in s, monotonic."""

    def __init__(self, first: int, countdown: int, longest: float) -> None:
        self._number, self._countdown, self._longest = first, countdown, longest
        self._begins: float | None = None  # while it counts
        self._counted = 0
        self._since: float | None = None  # while an episode runs
        self._last: int | None = None

    @property
    def running(self) -> bool:
        return self._since is not None

    @property
    def number(self) -> int:
        """Of the episode that runs, or comes next."""
        return self._number

    def mark(self, mark: str, now: float) -> tuple[EpisodeChange, ...]:
        """Returns what a mark changes; raises EpisodeFault if it fits to nothing."""
        if mark not in MARKS:
            raise EpisodeFault(f"The mark is {mark!r}, but must be one of {', '.join(MARKS)}.")
        if self._since is not None:
            if mark == BEGIN:
                raise EpisodeFault(f"Episode {self._number} runs; end it by success, failure or discard first.")
            ended = self._end(DISCARDED if mark == AGAIN else SAID[mark])
            return ended + (self._count(now) if mark == AGAIN else ())
        if self._begins is not None and mark in (BEGIN, AGAIN):
            raise EpisodeFault(f"Episode {self._number} is about to begin.")
        if self._begins is not None:
            self._begins = None  # before it began there is nothing to keep
            return ()
        if mark == BEGIN:
            return self._count(now)
        if self._last is None:
            raise EpisodeFault("There is no episode yet; begin one.")
        labelled = (EpisodeChange(LABELLED, self._last, DISCARDED if mark == AGAIN else SAID[mark]),)
        return labelled + (self._count(now) if mark == AGAIN else ())

    def step(self, now: float) -> tuple[EpisodeChange, ...]:
        """Returns what happened by the time alone."""
        if self._begins is not None:
            left = self._begins - now
            if left <= 0.0:
                self._begins, self._since = None, now
                return (EpisodeChange(BEGUN, self._number),)
            if left <= self._counted - 1:
                self._counted -= 1
                return (EpisodeChange(COUNTED, self._counted),)
        elif self._since is not None and now - self._since >= self._longest:
            return self._end("")
        return ()

    def close(self) -> tuple[EpisodeChange, ...]:
        """Ends the episode that runs, without an outcome."""
        self._begins = None
        return () if self._since is None else self._end("")

    def _count(self, now: float) -> tuple[EpisodeChange, ...]:
        self._begins, self._counted = now + self._countdown, self._countdown
        return (EpisodeChange(COUNTED, self._countdown),) if self._countdown else ()

    def _end(self, outcome: str) -> tuple[EpisodeChange, ...]:
        ended = EpisodeChange(ENDED, self._number, outcome)
        self._since, self._last, self._number = None, self._number, self._number + 1
        return (ended,)


@dataclass(frozen=True)
class EpisodeLabel:
    """What is said of an episode."""

    said: str = ""  # by a person, one of OUTCOMES; empty: nothing
    measured: str = ""  # by the world or the taxels, `success` or `failure`; empty: unknown
    why: str = ""  # of what was measured, a clause
    task: str = ""  # in words
    operator: str = ""
    note: str = ""  # of the cockpit's mark
    schema: int = SCHEMA

    @property
    def outcome(self) -> str:
        return self.said or self.measured


def write_label(folder: Path, label: EpisodeLabel) -> None:
    """Replaces the label of an episode as a whole; OSError as of the disk."""
    write_whole(folder / LABEL, yaml.safe_dump(asdict(label), sort_keys=False, allow_unicode=True))


def read_label(folder: Path) -> EpisodeLabel:
    """Returns the label of an episode; raises EpisodeFault for any other file."""
    path = folder / LABEL
    try:
        content: Any = yaml.safe_load(read_text(path))
    except OSError as error:
        raise EpisodeFault(f"{path} cannot be read: {error.strerror}.") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise EpisodeFault(f"{path} is no YAML: {' '.join(str(error).split())}.") from error
    kinds = {field.name: int if field.name == "schema" else str for field in fields(EpisodeLabel)}
    if not isinstance(content, dict) or not content.keys() <= kinds.keys() or content.get("schema") != SCHEMA:
        raise EpisodeFault(f"{path} is no label of an episode: it needs schema: {SCHEMA}, and {', '.join(kinds)} only.")
    for name, value in content.items():
        if not isinstance(value, kinds[name]):
            raise EpisodeFault(f"{path} has {name}: {value!r}, but a text is needed.")
    label = EpisodeLabel(**content)
    for name, known in (("said", OUTCOMES), ("measured", (SUCCESS, FAILURE))):
        if getattr(label, name) not in ("", *known):
            raise EpisodeFault(f"{path} has {name}: {getattr(label, name)!r}, but must be one of {', '.join(known)}.")
    return label


def relabel(folder: Path, said: str) -> EpisodeLabel:
    """Changes what a person says of an episode, and returns the label; raises EpisodeFault or OSError."""
    label = replace(read_label(folder), said=said)
    write_label(folder, label)
    return label


def episode_folder(session: Path, number: int) -> Path:
    return session / f"episode_{number:05d}"


def episode_folders(session: Path) -> list[Path]:
    """Returns the folders of a session's episodes, in their order; none where there is no such folder."""
    if not session.is_dir():
        return []
    return sorted(path for path in session.iterdir() if FOLDER.fullmatch(path.name))


def next_number(session: Path) -> int:
    """Returns the number of a session's next episode."""
    found = episode_folders(session)
    return 1 + int(found[-1].name[-5:]) if found else 0


def chosen(session: Path, outcomes: tuple[str, ...] = (SUCCESS,)) -> list[Path]:
    """Returns a session's episodes with these outcomes; raises EpisodeFault without any, or of a bad label."""
    folders = episode_folders(session)
    found = [folder for folder in folders if read_label(folder).outcome in outcomes]
    if not found:
        wanted = " or ".join(outcomes)
        raise EpisodeFault(
            f"Of {len(folders)} episodes in {session} none is labelled {wanted}; label one, or choose another outcome."
        )
    return found
