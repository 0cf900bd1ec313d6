"""The schemas of settings.yaml and tags.yaml, with the keys of the published ROS package apriltag_ros, and the targets.
A target is a tag, or a bundle of tags that are rigidly fixed to each other. The frame of a tag has its origin in the
centre. Seen by a viewer who looks at the upright tag, x points right, y up and z towards the viewer."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from common.config import choice, flag, integer, number, parse, parse_part, text
from common.errors import ConfigError
from common.frames import frame_name
from common.poses import pose, read_only
from common.rotations import rotation_from_quaternion

FAMILIES = ("tag36h11", "tag36h10", "tag36artoolkit", "tag25h9", "tag25h7", "tag16h5")
"""The families that the library can decode."""
DEFAULT_FAMILY = "tag36h11"
CORNERS = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])
"""Corners of the black square in units of its edge: top left, top right, bottom right, bottom left."""


@dataclass(frozen=True, eq=False)
class TargetTag:
    """A tag of a target."""

    id: int  # number in the family
    size: float  # edge of the black square [m]
    T_target_tag: np.ndarray = field(default_factory=lambda: read_only(np.eye(4)))  # pose of the tag, shape (4, 4) [m]

    @property
    def corners(self) -> np.ndarray:
        """The corners in the frame of the target, in the order of `CORNERS`, shape (4, 3) [m]."""
        return self.size * CORNERS @ self.T_target_tag[:3, :3].T + self.T_target_tag[:3, 3]


@dataclass(frozen=True)
class TagTarget:
    """One tag or a bundle of tags that gets one pose; `name` is its tf frame."""

    name: str
    tags: tuple[TargetTag, ...]

    @property
    def corners(self) -> np.ndarray:
        """The corners of all tags in the frame of the target, shape (4 n, 3) [m]."""
        return np.concatenate([tag.corners for tag in self.tags])

    def matched(self, corners: dict[int, np.ndarray]) -> tuple[tuple[TargetTag, ...], np.ndarray, np.ndarray]:
        """Returns the detected tags of the target, and their corners in the target, shape (4 n, 3) [m], and in the
        image, shape (4 n, 2) [px], from the detected corners by tag id, each shape (4, 2) [px]."""
        tags = tuple(tag for tag in self.tags if tag.id in corners)
        if not tags:
            return (), np.empty((0, 3)), np.empty((0, 2))
        return tags, np.concatenate([tag.corners for tag in tags]), np.concatenate([corners[tag.id] for tag in tags])


@dataclass(frozen=True)
class DetectorSettings:
    """The settings of the detector. A key that the library does not support accepts only the library's own value; a
    missing key has the default of the published package."""

    tag_family: str = choice(*FAMILIES, doc="family of the tags", absent=DEFAULT_FAMILY)
    tag_threads: int = integer(
        low=0, high=64, doc="threads of the detector; 0: one fewer than the processors", absent=2
    )
    tag_decimate: float = number(low=1.0, high=8.0, doc="factor by which the image is first scaled down", absent=1.0)
    tag_blur: float = number("px", low=0.0, high=10.0, doc="sigma of the blur before the detection", absent=0.0)
    tag_refine_edges: int = integer(low=1, high=1, doc="the library always fits lines to the edges", absent=1)
    tag_debug: int = integer(low=0, high=0, doc="the library's own debug images are not offered", absent=0)
    max_hamming_dist: int = integer("bits", low=0, high=10, doc="maximum number of corrected bits", absent=2)
    publish_tf: bool = flag("also publish the poses in tf", absent=False)
    transport_hint: str = choice("raw", doc="only raw images can be subscribed to", absent="raw")
    remove_duplicates: bool = flag("drop an id that appears twice in one image", absent=True)
    publish_tag_detections_image: bool = flag("also publish the image with the tags drawn", absent=False)
    rectified: bool = flag(
        "whether the images are rectified; otherwise the distortion is removed from the corners", absent=True
    )


@dataclass(frozen=True)
class _Standalone:
    id: int = integer(low=0, doc="of the tag")
    size: float = number("m", low=0.002, high=2.0, doc="edge of the black square")


@dataclass(frozen=True)
class _Member(_Standalone):
    x: float = number("m", low=-10.0, high=10.0, absent=0.0, doc="centre of the tag in the bundle")
    y: float = number("m", low=-10.0, high=10.0, absent=0.0)
    z: float = number("m", low=-10.0, high=10.0, absent=0.0)
    qw: float = number(absent=1.0, doc="orientation of the tag in the bundle")
    qx: float = number(absent=0.0)
    qy: float = number(absent=0.0)
    qz: float = number(absent=0.0)


@dataclass(frozen=True)
class _Name:
    name: str = text(doc="frame in tf", taken_as=frame_name)


KEYS = {f.name for f in fields(DetectorSettings)}
TAG_KEYS = ("standalone_tags", "tag_bundles")


def detector_settings(values: Mapping[str, Any], prefix: str = "", others: tuple[str, ...] = ()) -> DetectorSettings:
    """Returns the settings in `values`, with the defaults of the published package; raises ConfigError with all
    faults."""
    return parse(DetectorSettings, values, prefix, others=(*TAG_KEYS, *others))


def targets(values: Mapping[str, Any]) -> tuple[TagTarget, ...]:
    """Returns the targets in `standalone_tags` and `tag_bundles`, either of which may be missing or empty; raises
    ConfigError with all faults."""
    if not isinstance(values, Mapping):
        raise ConfigError([f"The tags are {values!r}, but must be a mapping with the keys {' and '.join(TAG_KEYS)}."])
    faults: list[str] = []
    alone, bundles = _standalone(values, faults), _bundles(values, faults)
    found = (*alone, *bundles)
    names = Counter(target.name for target in found)
    faults += [f"{n} targets have the name {name}: give each its own tf frame." for name, n in names.items() if n > 1]
    faults += _contradictions(alone, bundles)
    if not found and not faults:
        faults.append("standalone_tags and tag_bundles are both empty: load a tags.yaml.")
    if faults:
        raise ConfigError(faults)
    return found


def _standalone(values: Mapping[str, Any], faults: list[str]) -> list[TagTarget]:
    found = []
    for i, entry in enumerate(_entries(values, "standalone_tags", faults)):
        where = f"standalone_tags[{i}]/"
        tag = parse_part(_Standalone, entry, where, faults, ("name",))
        if tag is not None:
            found.append(TagTarget(_name(entry, f"tag_{tag.id}", where, faults), (TargetTag(tag.id, tag.size),)))
    return found


def _bundles(values: Mapping[str, Any], faults: list[str]) -> list[TagTarget]:
    found = []
    for i, entry in enumerate(_entries(values, "tag_bundles", faults)):
        where = f"tag_bundles[{i}]/"
        if not isinstance(entry, Mapping) or set(entry) - {"name", "layout"}:
            faults.append(f"tag_bundles[{i}] is {entry!r}, but must be a mapping with the keys name and layout.")
            continue
        layout = _entries(entry, "layout", faults, where)
        read = [_member(item, f"{where}layout[{k}]/", faults) for k, item in enumerate(layout)]
        members = tuple(member for member in read if member is not None)
        if not layout:
            faults.append(f"{where}layout has no tags: list the tags of the bundle.")
        elif len(members) == len(layout):
            found.append(TagTarget(_name(entry, f"bundle_{i}", where, faults), members))
    return found


def _contradictions(alone: list[TagTarget], bundles: list[TagTarget]) -> list[str]:
    """Returns a sentence for each id that is listed twice or with two sizes; an id may be standalone and in bundles."""
    groups = [[tag for target in alone for tag in target.tags], *(list(bundle.tags) for bundle in bundles)]
    twice = sorted({i for tags in groups for i, n in Counter(tag.id for tag in tags).items() if n > 1})
    sizes: dict[int, set[float]] = {}
    for tag in (tag for tags in groups for tag in tags):
        sizes.setdefault(tag.id, set()).add(tag.size)
    return [f"The tag {i} is listed twice: remove one entry." for i in twice] + [
        f"The tag {i} has the sizes {sorted(s)} m, but it has one: measure it." for i, s in sizes.items() if len(s) > 1
    ]


def _entries(values: Mapping[str, Any], key: str, faults: list[str], prefix: str = "") -> list:
    entries = values.get(key) or []
    if isinstance(entries, list):
        return entries
    faults.append(f"{prefix}{key} is {entries!r}, but must be a list.")
    return []


def _name(entry: Mapping[str, Any], default: str, where: str, faults: list[str]) -> str:
    read = parse_part(_Name, {"name": entry.get("name", default)}, where, faults)
    return default if read is None else read.name


def _member(entry: Any, where: str, faults: list[str]) -> TargetTag | None:
    member = parse_part(_Member, entry, where, faults)
    if member is None:
        return None
    try:
        R = rotation_from_quaternion([member.qx, member.qy, member.qz, member.qw])
    except ValueError as error:
        faults.append(f"{where}: {error}.")
        return None
    return TargetTag(member.id, member.size, pose(R, np.array([member.x, member.y, member.z])))
