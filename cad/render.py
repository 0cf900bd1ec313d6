"""Pictures of STL files, rendered by MuJoCo without a screen."""

from __future__ import annotations

import contextlib
import struct
import zlib
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

WIDTH, HEIGHT = 480, 360
WHITE = (255, 255, 255)
FOVY_DEG = 30.0
COLOURS = {
    "blue": "0.36 0.60 0.86 1",
    "amber": "0.93 0.66 0.22 1",
    "green": "0.35 0.62 0.40 1",
    "grey": "0.6 0.6 0.62 1",
}


def add_part(root: ET.Element, parent: ET.Element, stl: Path, colour: str, pos="0 0 0", quat="1 0 0 0") -> None:
    """Adds an STL file in mm as a shape that is only seen."""
    asset = root.find("asset")
    if asset.find(f"mesh[@name='{stl.stem}']") is None:
        ET.SubElement(asset, "mesh", name=stl.stem, file=str(stl.resolve()), scale="0.001 0.001 0.001")
    look = {"rgba": COLOURS[colour], "contype": "0", "conaffinity": "0", "group": "0"}
    ET.SubElement(parent, "geom", type="mesh", mesh=stl.stem, pos=pos, quat=quat, **look)


def empty_scene() -> tuple[ET.Element, ET.Element]:
    """Returns a model without anything and its world."""
    root = ET.Element("mujoco")
    visual = ET.SubElement(root, "visual")
    ET.SubElement(visual, "headlight", ambient="0.4 0.4 0.4", diffuse="0.3 0.3 0.3", specular="0 0 0")
    ET.SubElement(root, "asset")
    world = ET.SubElement(root, "worldbody")
    ET.SubElement(world, "light", dir="-0.5 0.4 -0.8", pos="0 0 2", directional="true", diffuse="0.5 0.5 0.5")
    return root, world


def render(
    root: ET.Element,
    file: Path,
    azimuth: float,
    elevation: float,
    target=None,
    distance: float | None = None,
    joints: dict[str, float] | None = None,
) -> None:
    """Writes a picture of a model on white.

    Args:
        root: MuJoCo's XML.
        azimuth, elevation: of the direction in which the camera looks [deg].
        target, distance: what it looks at and from how far [m]; None: all that there is.
        joints: angles by the joint's name [rad].
    """
    visual = root.find("visual")
    for old in [*visual.findall("global"), *visual.findall("quality"), *visual.findall("map")]:
        visual.remove(old)
    ET.SubElement(visual, "global", offwidth=str(WIDTH), offheight=str(HEIGHT), fovy=str(FOVY_DEG))
    ET.SubElement(visual, "quality", offsamples="8", shadowsize="0")
    ET.SubElement(visual, "map", znear="0.01", zfar="50")
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    data = mujoco.MjData(model)
    for name, angle in (joints or {}).items():
        data.joint(name).qpos[0] = angle
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation = azimuth, elevation
    middle = (data.geom_xpos.min(0) + data.geom_xpos.max(0)) / 2
    reach = (np.linalg.norm(data.geom_xpos - middle, axis=1) + model.geom_rbound).max()
    camera.lookat[:] = middle if target is None else target
    camera.distance = 2.9 * reach if distance is None else distance
    with contextlib.closing(mujoco.Renderer(model, HEIGHT, WIDTH)) as renderer:
        renderer.update_scene(data, camera)
        picture = renderer.render().copy()
        renderer.enable_segmentation_rendering()
        renderer.update_scene(data, camera)
        picture[renderer.render()[..., 0] < 0] = WHITE
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(png(picture))


def png(picture: np.ndarray) -> bytes:
    """Returns a picture, shape (height, width, 3), as PNG with 6 bits a colour, which keeps files small."""
    rows = (picture & 0xFC | 0x02).astype(np.uint8).reshape(len(picture), -1)
    up = rows.copy()
    up[1:] -= rows[:-1]
    data = np.column_stack([np.full(len(rows), 2, dtype=np.uint8), up]).tobytes()
    header = struct.pack(">IIBBBBB", picture.shape[1], picture.shape[0], 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(data, 9)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )
