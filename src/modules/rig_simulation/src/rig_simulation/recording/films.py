"""Films and contact sheets of a sequence of pictures, each with the time that it shows."""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from common.errors import RigError

WHITE, BLACK = (255, 255, 255), (0, 0, 0)
MARGIN_PX, LINE_PX, LETTERS = 10, 24, 0.6
LEAST_FREE_BYTES = 2**24
"""With less left on the disk a film ends: its index, without which nothing of it is readable, comes last."""


class FilmError(RigError):
    """A file that cannot be written."""


class Film(Protocol):
    """What pictures are put into."""

    def add(self, picture: np.ndarray, time: float) -> None:
        """Takes a picture, shape (height, width, 3), RGB, uint8, of the time [s]."""

    def close(self) -> None:
        """Writes what is left."""


def film_for(path: Path, rate: float) -> Film:
    """Returns the film that the file's suffix asks for: .mp4 or .png.

    Raises:
        FilmError: another suffix, or no such folder.
    """
    if not path.resolve().parent.is_dir():
        raise FilmError(f"There is no folder {path.resolve().parent} for {path.name}.")
    if path.suffix == ".mp4":
        return Mp4(path, rate)
    if path.suffix == ".png":
        return ContactSheet(path)
    raise FilmError(f"The file {path} must end with .mp4 (a film) or .png (a contact sheet).")


class Mp4:
    """A film in the time of its pictures: where they come late, the one before stays.

    Args:
        path: of the file.
        rate: pictures a second.
    """

    def __init__(self, path: Path, rate: float) -> None:
        self._path, self._rate = path, rate
        self._writer: cv2.VideoWriter | None = None
        self._start = 0.0
        self._last = np.empty(0)
        self.frames = 0

    def add(self, picture: np.ndarray, time: float) -> None:
        """Takes a picture; see Film.

        Raises:
            FilmError: the film cannot be written, or the disk is nearly full; what was taken before stays.
        """
        if shutil.disk_usage(self._path.resolve().parent).free < LEAST_FREE_BYTES:
            raise FilmError(
                f"The film {self._path} ends after {self.frames / self._rate:.1f} s: "
                f"less than {LEAST_FREE_BYTES / 1e6:.0f} MB are free on its disk."
            )
        if self._writer is None:
            self._start = time
            height, width = picture.shape[:2]
            self._writer = cv2.VideoWriter(
                str(self._path), cv2.VideoWriter.fourcc(*"mp4v"), self._rate, (width, height)
            )
            if not self._writer.isOpened():
                raise FilmError(f"The film {self._path} cannot be written.")
        due = math.floor((time - self._start) * self._rate + 1e-6)
        while self.frames < due:
            self._write(self._writer, self._last)
        if self.frames == due:
            self._write(self._writer, cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))

    def close(self) -> None:
        """Ends the file.

        Raises:
            FilmError: it does not hold all pictures; the writer itself never complains.
        """
        if self._writer is None:
            return
        self._writer.release()
        self._writer = None
        written = cv2.VideoCapture(str(self._path))
        count = round(written.get(cv2.CAP_PROP_FRAME_COUNT)) if written.isOpened() else 0
        written.release()
        if count != self.frames:
            raise FilmError(
                f"The film {self._path} is of no use: {count} of its {self.frames} pictures can be read; "
                "is the disk full?"
            )

    def _write(self, writer: cv2.VideoWriter, picture: np.ndarray) -> None:
        writer.write(picture)
        self._last = picture
        self.frames += 1


class ContactSheet:
    """A few pictures at equal intervals over the whole time, on one sheet.

    How long it will last is not known beforehand, so twice as many are kept as are shown, and whenever they are
    complete every second one goes.

    Args:
        path: of the file.
        columns, rows: of the sheet.
    """

    def __init__(self, path: Path, columns: int = 4, rows: int = 3) -> None:
        self._path, self._columns, self._count = path, columns, columns * rows
        self._interval = 0.1
        self._kept: list[np.ndarray] = []
        self._next = -math.inf

    def add(self, picture: np.ndarray, time: float) -> None:
        """Takes a picture; see Film."""
        if time < self._next:
            return
        half = cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        self._kept.append(cv2.cvtColor(half, cv2.COLOR_RGB2BGR))
        if len(self._kept) >= 2 * self._count:
            self._kept = self._kept[::2]
            self._interval *= 2.0
        self._next = time + self._interval

    def close(self) -> None:
        """Writes the sheet.

        Raises:
            FilmError: it cannot be written.
        """
        if not self._kept:
            return
        chosen = np.linspace(0, len(self._kept) - 1, min(self._count, len(self._kept))).round().astype(int)
        pictures = [self._kept[i] for i in chosen]
        pictures += [np.zeros_like(pictures[0])] * (-len(pictures) % self._columns)
        rows = [np.hstack(pictures[i : i + self._columns]) for i in range(0, len(pictures), self._columns)]
        if not cv2.imwrite(str(self._path), np.vstack(rows)):
            raise FilmError(f"The contact sheet {self._path} cannot be written.")


def with_lines(picture: np.ndarray, lines: list[str]) -> np.ndarray:
    """Returns the picture with lines of text in its upper left corner."""
    written = picture.copy()
    for i, line in enumerate(lines):
        at = (MARGIN_PX, MARGIN_PX + LINE_PX * (i + 1) - LINE_PX // 3)
        for colour, width in ((BLACK, 4), (WHITE, 1)):
            cv2.putText(written, line, at, cv2.FONT_HERSHEY_SIMPLEX, LETTERS, colour, width, cv2.LINE_AA)
    return written
