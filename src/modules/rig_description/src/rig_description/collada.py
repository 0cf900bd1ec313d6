"""A mesh as COLLADA text, which RViz loads with its smooth normals and its colour.

A template of our own writes short, reproducible files; pycollada would be larger to install and slower to start.
"""

from __future__ import annotations

import numpy as np

from rig_description.solids import Mesh

_TEMPLATE = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>2019-01-01T00:00:00</created><modified>2019-01-01T00:00:00</modified>\
<unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_effects><effect id="effect"><profile_COMMON><technique sid="common"><phong>
<ambient><color>{colour} 1</color></ambient>
<diffuse><color>{colour} 1</color></diffuse>
<specular><color>{shine} {shine} {shine} 1</color></specular>
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


def collada(mesh: Mesh, colour: tuple[float, float, float], shine: float = 0.2) -> str:
    """Returns the text of a file: coordinates to a tenth of a millimetre, written in mm, normals to a hundredth.

    Args:
        colour: red, green, blue from 0 to 1.
        shine: strength of the highlights from 0 to 1.
    """
    return _TEMPLATE.format(
        colour=" ".join(f"{value:g}" for value in colour),
        shine=f"{shine:g}",
        vertices=_source("positions", mesh.vertices, 1),
        normals=_source("normals", mesh.normals, 2),
        count=len(mesh.triangles),
        triangles=" ".join(str(index) for index in mesh.triangles.ravel()),
    )


def _source(name: str, rows: np.ndarray, digits: int) -> str:
    values = " ".join(_short(value, digits) for value in rows.ravel())
    return _SOURCE.format(name=name, count=rows.size, rows=len(rows), values=values)


def _short(value: float, digits: int) -> str:
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
