"""Every file that is generated from the tables: its path in the package and its text."""

from __future__ import annotations

from rig_description import arm_shapes, hand_shapes
from rig_description.appearance import WHITE
from rig_description.arms import ARMS, MEDIA_FLANGES
from rig_description.collada import collada
from rig_description.urdf import file_name, urdf


def all_files() -> dict[str, str]:
    """Returns the text of each file by its path below the package's folder."""
    files = {}
    for robot, arm in ARMS.items():
        for flange in MEDIA_FLANGES:
            for ring in (False, True):
                files[f"urdf/{file_name(robot, flange, ring)}"] = urdf(robot, flange, ring)
        for link in range(7):
            files[f"meshes/{robot.lower()}/link_{link}.dae"] = collada(arm_shapes.housing(arm, link), WHITE)
    for name, (make, colour) in hand_shapes.MESHES.items():
        files[f"meshes/reflex/{name}.dae"] = collada(make(), colour)
    return files
