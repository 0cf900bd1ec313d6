"""The meshes of the robot's description, COLLADA with one surface of one colour, as arrays.

Twenty lines read what rig_description writes; trimesh with pycollada would add two packages and their start time.
"""

from __future__ import annotations

import dataclasses
from xml.etree import ElementTree as ET

import numpy as np

_NAMESPACE = {"c": "http://www.collada.org/2005/11/COLLADASchema"}


@dataclasses.dataclass(frozen=True)
class TriangleSurface:
    """A closed surface of one colour."""

    vertices: np.ndarray  # shape (n, 3), in the file's unit
    triangles: np.ndarray  # indices of vertices, shape (m, 3)
    colour: np.ndarray  # red, green, blue from 0 to 1, shape (3,)


def surface_from_collada(text: str) -> TriangleSurface:
    """Returns the surface in a file of rig_description, in which each vertex has one normal with the same index.

    Raises:
        ValueError: the text lacks positions, triangles or the colour.
    """
    root = ET.fromstring(text)
    positions = root.findtext(".//c:source[@id='positions']/c:float_array", namespaces=_NAMESPACE)
    indices = root.findtext(".//c:triangles/c:p", namespaces=_NAMESPACE)
    colour = root.findtext(".//c:diffuse/c:color", namespaces=_NAMESPACE)
    if not positions or not indices or not colour:
        raise ValueError("The COLLADA text lacks positions, triangles or the colour; generate the meshes again.")
    return TriangleSurface(
        np.array(positions.split(), dtype=float).reshape(-1, 3),
        np.array(indices.split(), dtype=int).reshape(-1, 3),
        np.array(colour.split(), dtype=float)[:3],
    )
