"""How old the picture is that the person sees, and its mark on a picture that is too old."""

from __future__ import annotations

import cv2
import numpy as np

DARK = 0.4
"""Brightness of a marked picture."""
FONT = cv2.FONT_HERSHEY_SIMPLEX
COLOUR = (255, 200, 60)


class PictureAge:
    """Measures how long ago the picture came that is shown."""

    def __init__(self) -> None:
        self._stamp: float | None = None
        self._since: float | None = None

    def is_new(self, stamp: float) -> bool:
        """Returns whether a picture with this stamp [s] is another one: a frozen camera repeats its last one."""
        return stamp != self._stamp

    def shown(self, stamp: float, since: float) -> None:
        """Takes in that a picture with this stamp [s], which came at the time `since` [s], is shown from now on."""
        self._stamp, self._since = stamp, since

    def age(self, now: float) -> float | None:
        """Returns the time since the picture came that is shown [s]; None before the first."""
        return None if self._since is None else now - self._since


def age_text(age: float | None) -> str:
    """Returns what stands on the picture."""
    if age is None:
        return "no picture yet"
    return f"{age:.1f} s old" if age < 60.0 else f"{age / 60.0:.0f} min old"


def mark_age(picture: np.ndarray, age: float | None) -> np.ndarray:
    """Returns the picture, shape (height, width, 3), darkened and with its age [s] in the middle."""
    marked = cv2.convertScaleAbs(picture, alpha=DARK)
    height, width = picture.shape[:2]
    text = age_text(age)
    scale = width / 400.0
    thickness = max(1, round(2.0 * scale))
    (length, tall), _ = cv2.getTextSize(text, FONT, scale, thickness)
    cv2.putText(marked, text, ((width - length) // 2, (height + tall) // 2), FONT, scale, COLOUR, thickness)
    return marked
