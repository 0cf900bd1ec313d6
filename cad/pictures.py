"""Renders the pictures of the STL files: each part, the connectors pulled apart, single tag and panel on the arm.

`python -m cad.pictures` in the project's folder with the environment of the rig, by `make cad`.
"""

from __future__ import annotations

import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import yaml

from cad import dimensions as d
from cad import manifest
from cad.render import COLOURS, add_part, empty_scene, render

ASSEMBLY = manifest.FOLDER / "assembly"
ROOT = Path(__file__).parents[1]
SIMULATION = ROOT / "src/modules/rig_simulation"

VIEWS = {
    "kuka_connector": (60, -42),
    "hand_connector": (60, -42),
    "centring_sleeve": (60, -42),
    "marker_connector": (25, -28),
    "marker_plate": (60, 40),
    "panel_bracket": (60, 40),
    "camera_holder": (55, -28),
    "camera_jaw": (-120, -25),
    "leap_holder": (60, -40),
}
"""From where each part is seen, azimuth and elevation of the camera's direction [deg]."""

APART = (
    ("centring_sleeve", 0.022, "green"),
    ("marker_connector", 0.046, "amber"),
    ("kuka_connector", 0.085, "blue"),
    ("hand_connector", 0.130, "blue"),
)
"""Part, height over the flange [m], colour."""

POSE_DEG = (0, 20, 10, -110, 0, 90, 30)
"""Joints of the arm at a calibration of the camera, the tag turned to who looks at the picture."""

QUAT_TAG = "0 0 0.70710678 0.70710678"
"""Attitude of the tag in the flange: its z axis is the flange's y axis, its y axis the flange's z axis."""

SEEN = {"contype": "0", "conaffinity": "0"}


def main() -> None:
    """Writes all pictures and notes them in the manifest."""
    for part, direction in VIEWS.items():
        root, world = empty_scene()
        add_part(root, world, manifest.stl(part), "blue")
        file = manifest.FOLDER / part / f"{part}.png"
        render(root, file, *direction)
        manifest.record([file], [manifest.stl(part)])
    _apart(ASSEMBLY / "connectors.png")
    _on_the_arm(ASSEMBLY / "single.png", "marker_plate", d.SINGLE_BEYOND, "single.yaml")
    _on_the_arm(ASSEMBLY / "panel.png", "panel_bracket", d.PANEL_BEYOND, "bundle.yaml")


def _apart(file: Path) -> None:
    root, world = empty_scene()
    size = f"{d.FLANGE_BODY / 2000} 0.0175"
    ET.SubElement(world, "geom", type="cylinder", size=size, pos="0 0 -0.0175", rgba=COLOURS["grey"], **SEEN)
    for part, height, colour in APART:
        add_part(root, world, manifest.stl(part), colour, pos=f"0 0 {height}")
    render(root, file, 25, -18, target=(0.0, 0.0, 0.05), distance=0.42)
    manifest.record([file], [manifest.stl(part) for part, _, _ in APART])


def _on_the_arm(file: Path, holder: str, beyond: float, tags: str) -> None:
    panel = yaml.safe_load((SIMULATION / "config/panels" / tags).read_text())
    root, flange = _arm_and_hand()
    parts = ("marker_connector", 0.0, "amber"), ("kuka_connector", d.RING, "blue")
    for part, height, colour in (*parts, ("hand_connector", d.RING + d.KUKA_CONNECTOR, "blue")):
        add_part(root, flange, manifest.stl(part), colour, pos=f"0 0 {height / 1000}")
    back = d.TAG_DISTANCE - d.SHEET - (d.PANEL_THICKNESS if holder == "panel_bracket" else 0.0)
    add_part(root, flange, manifest.stl(holder), "amber", pos=f"0 {back / 1000} {beyond / 1000}", quat=QUAT_TAG)

    face = ET.SubElement(flange, "body", pos=f"0 {d.TAG_DISTANCE / 1000} {beyond / 1000}", quat=QUAT_TAG)
    thickness = (d.TAG_DISTANCE - back) / 1000
    half = (*(np.array(panel["size"]) / 2), thickness / 2)
    box = {"size": "{} {} {}".format(*half), "pos": f"0 0 {-half[2]}", "rgba": "0.95 0.95 0.95 1"}
    ET.SubElement(face, "geom", type="box", **box, **SEEN)
    _add_tags(root, face, panel["tags"])
    joints = {f"kuka/joint_{i + 1}": angle for i, angle in enumerate(np.radians(POSE_DEG))}
    render(root, file, -75, -8, target=(0.26, 0.08, 0.33), distance=1.35, joints=joints)
    manifest.record([file], [manifest.stl(part) for part in ("marker_connector", holder)])


def _arm_and_hand() -> tuple[ET.Element, ET.Element]:
    """Returns the simulated rig alone, the hand lifted by the ring, and its flange."""
    for package in ("src/common/src", "src/modules/rig_description/src", "src/modules/rig_simulation/src"):
        if str(ROOT / package) not in sys.path:
            sys.path.append(str(ROOT / package))
    from rig_simulation.world.model import WorldDescription, mjcf

    scene = yaml.safe_load((SIMULATION / "config/scenes/cup.yaml").read_text())
    root = ET.fromstring(mjcf(WorldDescription("LBR7R800", "MF_elektrisch", (0.0, 0.0, 0.0), {**scene, "objects": {}})))
    world = root.find("worldbody")
    for name in ("floor", "table", "camera_link"):
        world.remove(world.find(f"body[@name='{name}']"))
    flange = root.find(".//body[@name='kuka/flange']")
    hand = flange.find("body[@name='reflex/base_link']")
    x, y, z = (float(value) for value in hand.get("pos").split())
    hand.set("pos", f"{x} {y} {z + d.RING / 1000}")
    hand.remove(hand.find("geom[@type='cylinder']"))  # the printed connectors stand in its place
    return root, flange


def _add_tags(root: ET.Element, face: ET.Element, tags) -> None:
    from rig_simulation.world.scene import tag_mesh

    for tag in tags:
        vertices, triangles = tag_mesh(tag["id"], tag["size"])
        numbers = {"vertex": vertices.ravel(), "face": triangles.ravel()}
        mesh = {key: " ".join(f"{x:g}" for x in values) for key, values in numbers.items()}
        name = f"tag_{tag['id']}"
        ET.SubElement(root.find("asset"), "mesh", name=name, **mesh)
        place = "{} {} 0".format(*tag["position"])
        ET.SubElement(face, "geom", type="mesh", mesh=name, pos=place, rgba="0.03 0.03 0.03 1", **SEEN)


if __name__ == "__main__":
    main()
