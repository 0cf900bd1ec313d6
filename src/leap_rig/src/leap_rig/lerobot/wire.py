"""What LeRobot's plug-ins and the rig send each other: a head, JSON, and the bytes of images.

    LEAP | version, 2 bytes | bytes of the JSON, 4 | bytes of the images, 4 | JSON | images

All big-endian. The JSON is an object; its entry `images` names the images in their order, with their sizes."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping
from typing import Any, NoReturn

from common.errors import RigError

MAGIC, VERSION = b"LEAP", 1
HEAD = struct.Struct(">4sHII")
MAX_JSON, MAX_IMAGES = 2**16, 2**26  # bytes
IMAGES = "images"


class LerobotWireFault(RigError):
    """What came is no message of this version; the text is a sentence."""


def packed(said: Mapping[str, Any], images: Mapping[str, bytes]) -> bytes:
    """Returns the bytes of a message; raises LerobotWireFault for a number that is not finite."""
    sizes = {name: len(image) for name, image in images.items()}
    try:
        text = json.dumps({**said, IMAGES: sizes}, allow_nan=False).encode()
    except ValueError as error:
        raise LerobotWireFault(f"A message has a number that is not finite: {error}.") from error
    return HEAD.pack(MAGIC, VERSION, len(text), sum(sizes.values())) + text + b"".join(images.values())


def unpacked(read: Callable[[int], bytes]) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Returns what a message says, and its images; `read` returns exactly so many bytes. Raises LerobotWireFault."""
    magic, version, length, size = HEAD.unpack(read(HEAD.size))
    if magic != MAGIC:
        raise LerobotWireFault(f"A message begins with {magic!r}, so the other side is not one of Leap Rig.")
    if version != VERSION:
        raise LerobotWireFault(f"The other side speaks version {version}, this one {VERSION}; install one release.")
    if length > MAX_JSON or size > MAX_IMAGES:
        raise LerobotWireFault(f"A message claims {length} and {size} bytes, more than {MAX_JSON} and {MAX_IMAGES}.")
    text, data = read(length), read(size)
    try:
        said = json.loads(text, parse_constant=_refuse)
        sizes = {str(name): int(one) for name, one in said.pop(IMAGES).items()}
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise LerobotWireFault(f"A message cannot be read: {error!r}.") from error
    if min(sizes.values(), default=0) < 0 or sum(sizes.values()) != size:
        raise LerobotWireFault(f"A message names images of {sum(sizes.values())} bytes, but holds {size}.")
    images, at = {}, 0
    for name, one in sizes.items():
        images[name], at = data[at : at + one], at + one
    return said, images


def _refuse(token: str) -> NoReturn:
    raise ValueError(f"{token} is not finite")
