"""Every file that is generated from the tables: its path in the package and its text; meshes are COLLADA.

RViz loads COLLADA with its smooth normals and its colour. A template of our own writes short, reproducible files;
pycollada would be larger to install and slower to start.
"""

from __future__ import annotations

import numpy as np

from rig_description.arms import ARMS, MEDIA_FLANGES
from rig_description.shapes import COLOURS, MESHES, housing
from rig_description.solids import Mesh
from rig_description.urdf import decimals, file_name, urdf

_TEMPLATE = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>2019-01-01T00:00:00</created><modified>2019-01-01T00:00:00</modified>\
<unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_effects><effect id="effect"><profile_COMMON><technique sid="common"><phong>
<ambient><color>{colour} 1</color></ambient>
<diffuse><color>{colour} 1</color></diffuse>
<specular><color>0.2 0.2 0.2 1</color></specular>
<shininess><float>30</float></shininess>
</phong></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="material"><instance_effect url="#effect"/></material></library_materials>
<library_geometries><geometry id="geometry"><mesh>
{vertices}
{normals}
<vertices id="vertices"><input semantic="POSITION" source="#positions"/></vertices>
<triangles count="{count}" material="material">
<input semantic="VERTEX" source="#vertices" offset="0"/><input semantic="NORMAL" source="#normals" offset="0"/>
<p>{triangles}</p>
</triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="scene"><node id="node"><instance_geometry url="#geometry">
<bind_material><technique_common><instance_material symbol="material" target="#material"/></technique_common>\
</bind_material></instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene>
</COLLADA>
"""
_SOURCE = """<source id="{name}"><float_array id="{name}-array" count="{count}">{values}</float_array>\
<technique_common><accessor source="#{name}-array" count="{rows}" stride="3">\
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>\
</accessor></technique_common></source>"""


def collada(mesh: Mesh, colour: str) -> str:
    """Returns the text of a file: coordinates to a tenth of a millimetre, written in mm, normals to a hundredth."""
    return _TEMPLATE.format(
        colour=" ".join(f"{value:g}" for value in COLOURS[colour]),
        vertices=_source("positions", mesh.vertices, 1),
        normals=_source("normals", mesh.normals, 2),
        count=len(mesh.triangles),
        triangles=" ".join(str(index) for index in mesh.triangles.ravel()),
    )


def _source(name: str, rows: np.ndarray, digits: int) -> str:
    return _SOURCE.format(name=name, count=rows.size, rows=len(rows), values=decimals(rows.ravel(), digits))


def all_files() -> dict[str, str]:
    """Returns the text of each file by its path below the package's folder."""
    files = {}
    for robot, arm in ARMS.items():
        for flange in MEDIA_FLANGES:
            for ring in (False, True):
                files[f"urdf/{file_name(robot, flange, ring)}"] = urdf(robot, flange, ring)
        for link in range(7):
            files[f"meshes/{robot.lower()}/link_{link}.dae"] = collada(housing(arm, link), "white")
    for name, (make, colour) in MESHES.items():
        files[f"meshes/reflex/{name}.dae"] = collada(make(), colour)
    return files
