"""The file of an episode: a numpy archive (.npz), one array for each entry of `LAYOUT`, without pickled objects.

`meta` is a JSON object with the schema version, the entries of `Metadata`, the fingerprint, and the camera's name and
size. Every array has a checksum in the archive, so that a torn or damaged file is noticed.
"""

from __future__ import annotations

import io
import json
import lzma
import tokenize
import zipfile
import zlib
from dataclasses import asdict, fields
from datetime import datetime, timezone
from typing import Any, NoReturn

import numpy as np

from common.camera_model import CameraModel
from common.errors import RigError
from common.plausible import FARTHEST_M, NEAREST_M, check_near
from common.poses import check_pose
from grasping.lab.dataset.episode import NOWHERE, SOURCES, Episode, Metadata, tool_of_label
from grasping.network.depth_image import NETWORK_SIDE, Crop

SCHEMA = 3
MAGIC = b"PK\3\4"  # how an archive begins
DAMAGE = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, tokenize.TokenError, SyntaxError, EOFError, MemoryError,
          ValueError, RuntimeError, KeyError, OSError)  # fmt: skip
"""What numpy raises for a damaged archive, whose headers may say anything."""
ARRAY = ".npy"
PREFIX, SUFFIX = "episode_", ".npz"
NAME = PREFIX + "%Y%m%dT%H%M%S_%f"
LAYOUT = {  # type and shape of each array; n frames, `side` of the crop, m rows of a map
    "meta": ("U", ()),
    "camera_K": ("f8", (3, 3)),
    "camera_D": ("f8", (5,)),
    "camera_R": ("f8", (3, 3)),
    "camera_P": ("f8", (3, 4)),
    "crop": ("i4", (3,)),
    "T_flange_tool": ("f8", (4, 4)),
    "T_tool_grasp": ("f8", (4, 4)),
    "T_base_tool_closed": ("f8", (4, 4)),
    "T_base_tool_shown": ("f8", (4, 4)),
    "T_base_grasp": ("f8", (4, 4)),
    "t_grasp": ("f8", ()),
    "held": ("?", ()),
    "lift": ("f8", ()),
    "stamp": ("f8", ("n",)),
    "depth": ("u2", ("n", "side", "side")),
    "maps": ("f2", ("n", 4, "m", "m")),
    "mean": ("f4", ("n",)),
    "peak": ("f8", ("n", 5)),
    "T_base_camera": ("f8", ("n", 4, 4)),
    "T_base_tool_measured": ("f8", ("n", 4, 4)),
    "T_base_tool_desired": ("f8", ("n", 4, 4)),
    "finger_angles": ("f4", ("n", 4)),
    "teleop_active": ("?", ("n",)),
}
SINCE = {"T_base_tool_shown": (2, NOWHERE), "lift": (3, np.array(np.nan))}
"""Schema that an array came with, and what stands for it in files of earlier ones."""
MAY_BE_NAN = {"T_base_tool_desired", "finger_angles", *SINCE}
POSES = [name for name in LAYOUT if name.startswith("T_")]
TEXTS = [f.name for f in fields(Metadata) if f.name != "configuration"]


class DatasetError(RigError):
    """A file holds no episode that can be used."""


def file_name(episode: Episode) -> str:
    """Returns the name of the file of an episode: the moment of its grasp, UTC, to the millisecond."""
    moment = datetime.fromtimestamp(episode.t_grasp, timezone.utc)
    return f"{moment.strftime(NAME)[:-3]}{SUFFIX}"


def grasp_time(name: str) -> float | None:
    """Returns the moment of the grasp [s] of a file of that name; None if it is not named by `file_name`."""
    try:
        return datetime.strptime(name, NAME + SUFFIX).replace(tzinfo=timezone.utc).timestamp()
    except ValueError:
        return None


def unfinished(name: str) -> bool:
    """Returns whether a file of that name was left by a process that died while it wrote an episode."""
    return name.startswith(f".{PREFIX}") and SUFFIX in name


def encode(episode: Episode) -> bytes:
    """Returns an episode's file content; raises DatasetError if its arrays do not fit together or are not finite."""
    fast = 1  # level of compression: a third of the time of numpy's level, files 6 % larger
    camera = episode.camera
    meta = {
        "schema": SCHEMA,
        **asdict(episode.metadata),
        "fingerprint": episode.metadata.fingerprint,
        "camera": {"name": camera.name, "width": camera.width, "height": camera.height},
    }
    values: dict[str, Any] = {name: getattr(episode, name) for name in LAYOUT if hasattr(episode, name)}
    values.update(meta=json.dumps(meta, allow_nan=False), crop=episode.crop)
    values.update({f"camera_{key}": getattr(camera, key) for key in "KDRP"})
    arrays = {
        name: np.asarray(values[name], dtype=None if kind == "U" else np.dtype(kind).newbyteorder("<"))
        for name, (kind, _) in LAYOUT.items()
    }
    _check(arrays)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=fast) as archive:  # numpy offers no level
        for name, array in arrays.items():
            with archive.open(f"{name}{ARRAY}", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, array, allow_pickle=False)  # type: ignore[no-untyped-call]
    return stream.getvalue()


def decode(data: bytes) -> Episode:
    """Returns the episode in a file's content; raises DatasetError if it is torn, of another schema, or no episode."""
    arrays = _read(data)
    meta = _meta(arrays)
    later = {name: value for name, (since, value) in SINCE.items() if meta["schema"] < since}
    wanted = LAYOUT.keys() - later.keys()
    if arrays.keys() != wanted or not all(isinstance(array, np.ndarray) for array in arrays.values()):
        odd = ", ".join(sorted(arrays.keys() ^ wanted)) or "an array"
        raise DatasetError(f"Not an episode of its schema: {odd} missing or unknown.")
    arrays = {**later, **arrays}
    _check(arrays)
    for array in arrays.values():
        array.setflags(write=False)
    try:
        metadata = Metadata(**{name: str(meta[name]) for name in TEXTS}, configuration=dict(meta["configuration"]))
        named = meta["camera"]
        camera = CameraModel(
            str(named["name"]), int(named["width"]), int(named["height"]), *(arrays[f"camera_{key}"] for key in "KDRP")
        )
        fingerprint = meta["fingerprint"]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise DatasetError(f"The file's metadata lack or distort {error}.") from None
    if metadata.fingerprint != fingerprint:
        raise DatasetError("The file is damaged: the fingerprint is not that of the rig's configuration.")
    if metadata.source not in SOURCES:
        raise DatasetError(f"The file's source is {metadata.source!r}, not one of {', '.join(SOURCES)}.")
    own = {f.name for f in fields(Episode)}
    return Episode(
        metadata=metadata,
        camera=camera,
        crop=Crop(*(int(i) for i in arrays["crop"])),
        t_grasp=float(arrays["t_grasp"]),
        held=bool(arrays["held"]),
        lift=float(arrays["lift"]),
        **{name: arrays[name] for name in LAYOUT if name in own and name not in ("crop", "t_grasp", "held", "lift")},
    )


def _read(data: bytes) -> dict[str, Any]:
    """Returns the arrays of the archive, each as its checksum says it was written."""
    if not MAGIC.startswith(data[: len(MAGIC)]):
        raise DatasetError("Not an episode: the file is not an archive.")
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except DAMAGE as error:
        raise DatasetError(f"The file is torn or damaged: {' '.join(str(error).split())}.") from None


def _meta(arrays: dict[str, Any]) -> dict[str, Any]:
    """Returns the metadata, after the schema was checked."""
    if "meta" not in arrays:
        raise DatasetError("Not an episode: the file has no metadata.")
    try:
        meta = json.loads(str(arrays["meta"]), parse_constant=_refuse)
    except (ValueError, RecursionError):
        raise DatasetError("Not an episode: the file's metadata are not JSON.") from None
    if not isinstance(meta, dict) or "schema" not in meta:
        raise DatasetError("Not an episode: the file's metadata name no schema.")
    if meta["schema"] not in range(1, SCHEMA + 1):
        raise DatasetError(f"The file has the schema {meta['schema']!r}, but this version reads 1 to {SCHEMA}.")
    return meta


def _refuse(name: str) -> NoReturn:
    raise ValueError(f"{name} is no JSON")


def _check(arrays: dict[str, np.ndarray]) -> None:
    """Refuses arrays of another type or shape, that are not finite, or not poses, with the first fault."""
    sizes: dict[str, int] = {}
    for name, (kind, shape) in LAYOUT.items():
        array = arrays[name]
        found = array.dtype.kind == "U" if kind == "U" else array.dtype == np.dtype(kind)
        fits = len(array.shape) == len(shape) and all(
            size == (sizes.setdefault(want, size) if isinstance(want, str) else want)
            for size, want in zip(array.shape, shape)
        )
        if not (found and fits):
            raise DatasetError(f"The array {name} is {array.dtype}, shape {array.shape}, but must be {kind}, {shape}.")
        if array.dtype.kind == "f" and name not in MAY_BE_NAN and not np.isfinite(array).all():
            raise DatasetError(f"The array {name} holds values that are not finite.")
    _check_meaning(arrays, sizes)


def _check_meaning(arrays: dict[str, np.ndarray], sizes: dict[str, int]) -> None:
    """Refuses arrays whose values do not fit together."""
    grasp_tolerance = 1e-9
    stamp, t_grasp, mean = arrays["stamp"], float(arrays["t_grasp"]), arrays["mean"]
    if not sizes["n"]:
        raise DatasetError("The episode has no frame.")
    if np.any(np.diff(stamp) <= 0.0) or stamp[-1] > t_grasp:
        raise DatasetError("The stamps do not rise up to the moment of the grasp.")
    if not ((mean >= NEAREST_M) & (mean <= FARTHEST_M)).all():
        raise DatasetError(f"The mean depth of an image is {mean[np.abs(mean).argmax()]:g} m: it was not in metres.")
    if sizes["side"] != arrays["crop"][2] or NETWORK_SIDE % sizes["m"]:
        raise DatasetError(f"Images of {sizes['side']} px and maps of {sizes['m']} px do not belong together.")
    for name in POSES:
        for T in arrays[name].reshape(-1, 4, 4):
            if name in MAY_BE_NAN and np.isnan(T).all():
                continue
            try:
                check_near(check_pose(T))
            except ValueError as error:
                raise DatasetError(f"The array {name} holds no pose: {error}.") from None
    T = tool_of_label(arrays["T_base_tool_closed"], arrays["T_base_tool_shown"]) @ arrays["T_tool_grasp"]
    if np.abs(arrays["T_base_grasp"] - T).max() > grasp_tolerance:
        raise DatasetError("T_base_grasp is not the grasp of the tool that labels it.")
