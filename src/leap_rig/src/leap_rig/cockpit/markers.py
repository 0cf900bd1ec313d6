"""What markers (visualization_msgs/Marker and MarkerArray of ROS) say is to be drawn. Numbers are rounded to what an
eye sees from 2 m, so that the noise of a measurement is no change. Lengths in m, colours from 0 to 255."""

from __future__ import annotations

import enum
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from common.frames import frame_name

ADD, DELETE, DELETE_ALL = 0, 2, 3  # actions of a marker
MOST_POINTS = 20_000  # of one message
MOST_MARKERS = 1_000  # of one topic
MOST_LETTERS = 300
STEP_M = 5e-4  # to which lengths are rounded


class Kind(enum.IntEnum):
    """The types of visualization_msgs/Marker."""

    ARROW = 0
    CUBE = 1
    SPHERE = 2
    CYLINDER = 3
    LINE_STRIP = 4
    LINE_LIST = 5
    CUBE_LIST = 6
    SPHERE_LIST = 7
    POINTS = 8
    TEXT = 9
    MESH = 10
    TRIANGLES = 11


class Form(enum.Enum):
    """How a drawing is drawn."""

    LINES = "lines"  # points of shape (n, 2, 3)
    ARROWS = "arrows"  # points of shape (n, 2, 3); size: diameters of shaft and head, length of the head
    BOXES = "boxes"  # points: the middles, shape (n, 3); size: edges
    BALLS = "balls"  # size: diameters
    CYLINDERS = "cylinders"  # along z
    POINTS = "points"
    TRIANGLES = "triangles"  # points of shape (n, 3, 3)
    TEXT = "text"


FORMS = {
    Kind.ARROW: Form.ARROWS, Kind.CUBE: Form.BOXES, Kind.SPHERE: Form.BALLS, Kind.CYLINDER: Form.CYLINDERS,
    Kind.LINE_STRIP: Form.LINES, Kind.LINE_LIST: Form.LINES, Kind.CUBE_LIST: Form.BOXES, Kind.SPHERE_LIST: Form.BALLS,
    Kind.POINTS: Form.POINTS, Kind.TEXT: Form.TEXT, Kind.TRIANGLES: Form.TRIANGLES,
}  # fmt: skip


class MarkerFault(ValueError):
    """A marker cannot be drawn; the message says why."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """What one marker shows, in its frame."""

    form: Form
    frame: str
    position: tuple[float, float, float]
    orientation: tuple[float, float, float, float]  # x, y, z, w
    points: np.ndarray
    colours: np.ndarray  # shape (3,), or one for each of the points
    opacity: float
    size: tuple[float, float, float]
    text: str

    def same(self, other: Drawing) -> bool:
        """Whether nobody sees a difference between the two."""
        return self._scalars() == other._scalars() and all(
            np.array_equal(mine, others)
            for mine, others in ((self.points, other.points), (self.colours, other.colours))
        )

    def _scalars(self) -> tuple:
        return self.form, self.frame, self.position, self.orientation, self.opacity, self.size, self.text


class MarkerStore:
    """The markers of one topic. Those of the namespaces in `hidden` are left out; times in s, monotonic."""

    def __init__(self, hidden: Collection[str] = ()) -> None:
        self._hidden = hidden
        self._shown: dict[tuple[str, int], tuple[Drawing, float]] = {}
        self._said: set[str] = set()

    def take(self, markers: Iterable[Any], now: float) -> list[str]:
        """Takes one message or several; returns sentences on what cannot be drawn, each of them once."""
        before = dict(self._shown)
        faults = []
        room = MOST_POINTS
        for marker in _newest(markers):
            key = (marker.ns, marker.id)
            if marker.action == DELETE_ALL:
                self._shown.clear()
                continue
            self._shown.pop(key, None)
            if marker.action == DELETE or marker.ns in self._hidden:
                continue
            try:
                if len(marker.points) > room:
                    raise MarkerFault(f"there are more than {MOST_POINTS} points")
                room -= len(marker.points)
                drawing = _drawing(marker)
                if len(self._shown) >= MOST_MARKERS:
                    raise MarkerFault(f"there are more than {MOST_MARKERS} markers")
            except MarkerFault as fault:
                faults.append(f"A marker of the namespace {marker.ns[:60]!r} is not drawn: {fault}.")
                continue
            if drawing is None:
                continue
            lasts_s = marker.lifetime.to_sec()
            old, _ = before.get(key, (drawing, 0.0))
            self._shown[key] = old if old.same(drawing) else drawing, now + lasts_s if lasts_s > 0 else float("inf")
        return self._new(faults)

    def drawings(self, now: float) -> dict[tuple[str, int], Drawing]:
        """Returns what is drawn now, by namespace and number: the same object until it looks different."""
        self._shown = {key: (drawing, end) for key, (drawing, end) in self._shown.items() if end > now}
        return {key: drawing for key, (drawing, _) in self._shown.items()}

    def _new(self, faults: list[str]) -> list[str]:
        most = 20  # different sentences on one topic
        new = [fault for fault in dict.fromkeys(faults) if fault not in self._said][: most - len(self._said)]
        self._said.update(new)
        return new


def _newest(markers: Iterable[Any]) -> list[Any]:
    """Returns the last of the markers of each number, and none from before all were deleted."""
    kept: dict[Any, Any] = {}
    for marker in markers:
        if marker.action == DELETE_ALL:
            kept = {None: marker}
        else:
            key = marker.ns, marker.id
            kept.pop(key, None)
            kept[key] = marker
    return list(kept.values())


def _drawing(marker: Any) -> Drawing | None:
    """Returns what a marker shows, None if that is nothing; raises MarkerFault."""
    try:
        kind = Kind(marker.type)
        form = FORMS[kind]
    except (ValueError, KeyError):
        raise MarkerFault(f"its type is {marker.type}, a mesh or unknown") from None
    scale, pose, colour = marker.scale, marker.pose, marker.color
    points = np.array([(p.x, p.y, p.z) for p in marker.points], dtype=float).reshape(-1, 3)
    given = (scale.x, scale.y, scale.z, pose.position.x, pose.position.y, pose.position.z)
    turn = np.array([pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w])
    if not (np.isfinite(given).all() and np.isfinite(points).all() and np.isfinite(turn).all()):
        raise MarkerFault("it has numbers that are not finite")
    rgba = _colours(marker) if len(marker.colors) == len(points) > 0 else np.empty((0, 4))
    if not np.isfinite([colour.r, colour.g, colour.b, colour.a, *rgba.ravel()]).all():
        raise MarkerFault("its colour is not finite")
    longest = 1e3  # a coordinate, or the size of a thing [m]
    if max(np.abs(given).max(), np.abs(points).max(initial=0.0)) > longest:
        raise MarkerFault(f"it reaches farther than {longest:g} m")
    opacity = float(rgba[:, 3].max() if len(rgba) else colour.a)
    if opacity <= 0.0 or (form is Form.TEXT and not marker.text.strip()):
        return None
    colours = _bytes(rgba[:, :3]) if len(rgba) else _bytes(np.array([colour.r, colour.g, colour.b]))
    size = _rounded(np.abs(given[:3]))
    if kind is Kind.ARROW:
        if len(points) != 2:
            points = np.array([(0.0, 0.0, 0.0), (scale.x, 0.0, 0.0)])
            size = (size[1], 2.0 * size[1], 0.25 * size[0])
        elif not size[2]:
            size = (size[0], size[1], _rounded(0.23 * np.linalg.norm(points[1] - points[0]))[0])
        colours = colours.reshape(-1, 3)[0]
    elif kind in (Kind.CUBE, Kind.SPHERE, Kind.CYLINDER, Kind.TEXT):
        points, colours = np.zeros((1, 3)), colours.reshape(-1, 3)[0]
    if form in (Form.LINES, Form.ARROWS, Form.TRIANGLES):
        points, colours = _joined(kind, points, colours)
    if not len(points):
        return None
    return Drawing(
        form, frame_name(marker.header.frame_id), _rounded(given[3:]), _unit(turn), _on_grid(points), colours,
        min(round(opacity, 2), 1.0), size, marker.text[:MOST_LETTERS],
    )  # fmt: skip


def _joined(kind: Kind, points: np.ndarray, colours: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns points and their colours as pairs or triples, what is left over left out."""
    count = 3 if kind is Kind.TRIANGLES else 2

    def grouped(rows: np.ndarray) -> np.ndarray:
        if kind is Kind.LINE_STRIP:
            return np.stack([rows[:-1], rows[1:]], axis=1)
        return rows[: len(rows) // count * count].reshape(-1, count, 3)

    return grouped(points), grouped(colours) if colours.ndim > 1 else colours


def _colours(marker: Any) -> np.ndarray:
    return np.array([(c.r, c.g, c.b, c.a) for c in marker.colors], dtype=float)


def _bytes(colours: np.ndarray) -> np.ndarray:
    return (255.0 * np.clip(colours, 0.0, 1.0)).astype(np.uint8)


def _on_grid(lengths: np.ndarray) -> np.ndarray:
    return (np.round(lengths / STEP_M) * STEP_M).astype(np.float32)


def _rounded(lengths: Any) -> tuple:
    return tuple((np.round(np.atleast_1d(lengths) / STEP_M) * STEP_M).tolist())


def _unit(turn: np.ndarray) -> tuple[float, float, float, float]:
    """Returns the unit quaternion; of zeros, as a message without orientation has them, no rotation."""
    norm = float(np.linalg.norm(turn))
    x, y, z, w = (0.0, 0.0, 0.0, 1.0) if norm < 1e-9 else np.round(turn / norm, 3).tolist()
    return x, y, z, w
