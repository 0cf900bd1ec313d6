"""The surfaces in the mesh files of this package."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np

_COLLADA = {"c": "http://www.collada.org/2005/11/COLLADASchema"}


def surface_from_collada(text: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the surface of one colour in a COLLADA file of rig_description, whose vertices have one normal each:
    vertices, shape (n, 3), in the file's unit; triangles, shape (m, 3); red, green, blue from 0 to 1, shape (3,).
    Raises ValueError if the text lacks positions, triangles or the colour. Twenty lines read what rig_description
    writes; trimesh with pycollada would add two packages and their start time."""
    root = ET.fromstring(text)
    paths = ".//c:source[@id='positions']/c:float_array", ".//c:triangles/c:p", ".//c:diffuse/c:color"
    positions, indices, colour = (root.findtext(path, namespaces=_COLLADA) for path in paths)
    if not positions or not indices or not colour:
        raise ValueError("The COLLADA text lacks positions, triangles or the colour; generate the meshes again.")
    vertices = np.array(positions.split(), dtype=float).reshape(-1, 3)
    return vertices, np.array(indices.split(), dtype=int).reshape(-1, 3), np.array(colour.split(), dtype=float)[:3]
