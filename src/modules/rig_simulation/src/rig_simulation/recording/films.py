"""Films and contact sheets of a sequence of images with time stamps."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import cv2
import numpy as np

from common.errors import RigError


class FilmError(RigError):
    """A film or contact sheet that cannot be written."""


def film_for(path: Path, rate: float) -> Mp4 | ContactSheet:
    """Returns the film for a .mp4 or .png file; raises FilmError for another type or a missing folder."""
    if not path.parent.is_dir():
        raise FilmError(f"There is no folder {path.parent} for {path.name}; make it first.")
    if path.suffix == ".mp4":
        return Mp4(path, rate)
    if path.suffix == ".png":
        return ContactSheet(path)
    raise FilmError(f"The file {path} must end with .mp4 (a film) or .png (a contact sheet).")


class Mp4:
    """A film in the time of its images, `rate` a second; a late image prolongs the one before."""

    def __init__(self, path: Path, rate: float) -> None:
        self._path, self._rate = path, rate
        self._writer: cv2.VideoWriter | None = None
        self._start = 0.0
        self._last = np.empty(0)
        self.frames = 0

    def add(self, image: np.ndarray, time: float) -> None:
        """Adds an image, shape (height, width, 3), RGB, uint8, of the time [s]; raises FilmError if the disk is full or
        the film cannot be written: earlier images remain."""
        # with less free space a film stops: without its index, written last, it is unreadable
        least_free_bytes = 2**24
        if shutil.disk_usage(self._path.parent).free < least_free_bytes:
            full = f"its disk has less than {least_free_bytes / 1e6:.0f} MB free"
            raise FilmError(f"The film {self._path} stops after {self.frames / self._rate:.1f} s: {full}.")
        if self._writer is None:
            self._start = time
            height, width = image.shape[:2]
            code = cv2.VideoWriter.fourcc(*"mp4v")
            self._writer = cv2.VideoWriter(str(self._path), code, self._rate, (width, height))
            if not self._writer.isOpened():
                raise FilmError(f"Cannot write the film {self._path}.")
        due = math.floor((time - self._start) * self._rate + 1e-6)
        while self.frames < due:
            self._write(self._writer, self._last)
        if self.frames == due:
            self._write(self._writer, cv2.cvtColor(image, cv2.COLOR_RGB2BGR))

    def close(self) -> None:
        """Completes the file; raises FilmError if images are missing in it: the writer itself reports no error."""
        if self._writer is None:
            return
        self._writer.release()
        self._writer = None
        written = cv2.VideoCapture(str(self._path))
        count = round(written.get(cv2.CAP_PROP_FRAME_COUNT)) if written.isOpened() else 0
        written.release()
        if count != self.frames:
            readable = f"only {count} of its {self.frames} images are readable"
            raise FilmError(f"The film {self._path} is damaged: {readable}. Is the disk full?")

    def _write(self, writer: cv2.VideoWriter, image: np.ndarray) -> None:
        writer.write(image)
        self._last = image
        self.frames += 1


class ContactSheet:
    """A sheet of a few images at equal intervals. Its duration is unknown beforehand: it keeps up to twice as many
    images as it shows, and then drops every second."""

    def __init__(self, path: Path, columns: int = 4, rows: int = 3) -> None:
        self._path, self._columns, self._count = path, columns, columns * rows
        self._interval = 0.1
        self._kept: list[np.ndarray] = []
        self._next = -math.inf

    def add(self, image: np.ndarray, time: float) -> None:
        if time < self._next:
            return
        half = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        self._kept.append(cv2.cvtColor(half, cv2.COLOR_RGB2BGR))
        if len(self._kept) >= 2 * self._count:
            self._kept = self._kept[::2]
            self._interval *= 2.0
        self._next = time + self._interval

    def close(self) -> None:
        """Writes the sheet; raises FilmError if the file cannot be written."""
        if not self._kept:
            return
        chosen = np.linspace(0, len(self._kept) - 1, min(self._count, len(self._kept))).round().astype(int)
        images = [self._kept[i] for i in chosen]
        images += [np.zeros_like(images[0])] * (-len(images) % self._columns)
        rows = [np.hstack(images[i : i + self._columns]) for i in range(0, len(images), self._columns)]
        if not cv2.imwrite(str(self._path), np.vstack(rows)):
            raise FilmError(f"Cannot write the contact sheet {self._path}; is the disk full?")


def with_lines(image: np.ndarray, lines: list[str]) -> np.ndarray:
    white = (255, 255, 255)
    black = (0, 0, 0)
    margin_px = 10
    line_px = 24
    letters = 0.6
    written = image.copy()
    for i, line in enumerate(lines):
        at = (margin_px, margin_px + line_px * (i + 1) - line_px // 3)
        for colour, width in ((black, 4), (white, 1)):
            cv2.putText(written, line, at, cv2.FONT_HERSHEY_SIMPLEX, letters, colour, width, cv2.LINE_AA)
    return written
