"""What settings.yaml and tags.yaml hold: the keys of the published ROS package apriltag_ros, and what they may be."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from apriltag_ros.target import TagPlace, Target
from common.config import choice, flag, integer, number, parse, parse_part, text
from common.errors import ConfigError
from common.poses import pose
from common.rotations import rotation_from_quaternion

FAMILIES = ("tag36h11", "tag36h10", "tag36artoolkit", "tag25h9", "tag25h7", "tag16h5")
"""What the library can read."""

DEFAULT_FAMILY = "tag36h11"


@dataclass(frozen=True)
class DetectorSettings:
    """How tags are looked for. Keys that the detection library cannot honour may only have the value it works with; a
    key that a file does not have means what it means to the published package."""

    tag_family: str = choice(*FAMILIES, doc="family of the tags", absent=DEFAULT_FAMILY)
    tag_threads: int = integer(
        low=0, high=64, doc="threads of the detector; 0: one less than there are processors", absent=2
    )
    tag_decimate: float = number(low=1.0, high=8.0, doc="factor by which the picture is made smaller first", absent=1.0)
    tag_blur: float = number("px", low=0.0, high=10.0, doc="sigma of the blur before tags are looked for", absent=0.0)
    tag_refine_edges: int = integer(low=1, high=1, doc="the library always fits lines to the edges", absent=1)
    tag_debug: int = integer(low=0, high=0, doc="the library's own debug pictures are not offered", absent=0)
    max_hamming_dist: int = integer("bits", low=0, high=10, doc="so many wrong bits are put right", absent=2)
    publish_tf: bool = flag("publish the poses in tf also", absent=False)
    transport_hint: str = choice("raw", doc="only raw pictures can be subscribed to", absent="raw")
    remove_duplicates: bool = flag("drop an id that is seen twice in one picture", absent=True)
    publish_tag_detections_image: bool = flag("publish the picture with the tags drawn in also", absent=False)
    rectified: bool = flag(
        "whether the pictures are rectified already; otherwise the camera's distortion is undone", absent=True
    )


@dataclass(frozen=True)
class _Standalone:
    id: int = integer(low=0, doc="of the tag")
    size: float = number("m", above=0.0, high=10.0, doc="edge of the black square")


@dataclass(frozen=True)
class _Member(_Standalone):
    x: float = number("m", absent=0.0, doc="centre of the tag in the bundle")
    y: float = number("m", absent=0.0)
    z: float = number("m", absent=0.0)
    qw: float = number(absent=1.0, doc="attitude of the tag in the bundle")
    qx: float = number(absent=0.0)
    qy: float = number(absent=0.0)
    qz: float = number(absent=0.0)


@dataclass(frozen=True)
class _Name:
    name: str = text(doc="frame in tf")


KEYS = {f.name for f in fields(DetectorSettings)}
TAG_KEYS = ("standalone_tags", "tag_bundles")


def detector_settings(values: Mapping[str, Any], prefix: str = "", others: tuple[str, ...] = ()) -> DetectorSettings:
    """Returns the settings that `values` describe; what they leave out is as for the published package.

    Raises:
        ConfigError: with all faults.
    """
    return parse(DetectorSettings, values, prefix, others=(*TAG_KEYS, *others))


def targets(values: Mapping[str, Any]) -> tuple[Target, ...]:
    """Returns the tags and bundles to look for.

    Args:
        values: mapping with `standalone_tags` and `tag_bundles`; either may be missing or empty.

    Raises:
        ConfigError: with all faults.
    """
    faults: list[str] = []
    alone = _standalone(values, faults)
    bundles = _bundles(values, faults)
    found = (*alone, *bundles)
    faults += [f"The name {name} is given {n} times." for name, n in Counter(t.name for t in found).items() if n > 1]
    faults += _contradictions(alone, bundles)
    if not found and not faults:
        faults.append("There is no tag to look for: standalone_tags and tag_bundles are both empty.")
    if faults:
        raise ConfigError(faults)
    return found


def _standalone(values: Mapping[str, Any], faults: list[str]) -> list[Target]:
    found = []
    for i, entry in enumerate(_entries(values, "standalone_tags", faults)):
        where = f"standalone_tags[{i}]/"
        tag = parse_part(_Standalone, entry, where, faults, ("name",))
        if tag is not None:
            found.append(Target(_name(entry, f"tag_{tag.id}", where, faults), (TagPlace(tag.id, tag.size),)))
    return found


def _bundles(values: Mapping[str, Any], faults: list[str]) -> list[Target]:
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
            faults.append(f"{where}layout has no tags.")
        elif len(members) == len(layout):
            found.append(Target(_name(entry, f"bundle_{i}", where, faults), members))
    return found


def _contradictions(alone: list[Target], bundles: list[Target]) -> list[str]:
    """Returns a sentence for each id that is there twice, or has two sizes; it may stand alone and in bundles too."""
    groups = [[tag.id for target in alone for tag in target.tags], *([tag.id for tag in b.tags] for b in bundles)]
    twice = sorted({i for ids in groups for i, n in Counter(ids).items() if n > 1})
    sizes: dict[int, set[float]] = {}
    for target in (*alone, *bundles):
        for tag in target.tags:
            sizes.setdefault(tag.id, set()).add(tag.size)
    return [f"The tag {i} is there twice." for i in twice] + [
        f"The tag {i} has the sizes {sorted(s)} m, but it can have only one." for i, s in sizes.items() if len(s) > 1
    ]


def _entries(values: Mapping[str, Any], key: str, faults: list[str], prefix: str = "") -> list:
    entries = values.get(key) or []
    if not isinstance(entries, list):
        faults.append(f"{prefix}{key} is {entries!r}, but must be a list.")
        return []
    return entries


def _name(entry: Mapping[str, Any], default: str, where: str, faults: list[str]) -> str:
    read = parse_part(_Name, {"name": entry.get("name", default)}, where, faults)
    return default if read is None else read.name


def _member(entry: Any, where: str, faults: list[str]) -> TagPlace | None:
    member = parse_part(_Member, entry, where, faults)
    if member is None:
        return None
    try:
        R = rotation_from_quaternion([member.qx, member.qy, member.qz, member.qw])
    except ValueError as error:
        faults.append(f"{where}: {error}.")
        return None
    return TagPlace(member.id, member.size, pose(R, np.array([member.x, member.y, member.z])))
