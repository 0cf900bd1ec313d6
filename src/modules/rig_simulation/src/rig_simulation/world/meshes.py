"""The meshes of the robot's description, COLLADA with one surface of one colour, as arrays."""

from __future__ import annotations

import dataclasses
from xml.etree import ElementTree as ET

import numpy as np

_NAMESPACE = {"c": "http://www.collada.org/2005/11/COLLADASchema"}


@dataclasses.dataclass(frozen=True)
class TriangleSurface:
    """A closed surface of one colour.

    Attributes:
        vertices: shape (n, 3), in the file's unit.
        triangles: indices of vertices, shape (m, 3).
        colour: red, green, blue from 0 to 1, shape (3,).
    """

    vertices: np.ndarray
    triangles: np.ndarray
    colour: np.ndarray


def surface_from_collada(text: str) -> TriangleSurface:
    """Returns the surface in a file as rig_description writes it: each vertex has its own normal with the same index.

    Raises:
        ValueError: the text is no such file.
    """
    root = ET.fromstring(text)
    positions = root.findtext(".//c:source[@id='positions']/c:float_array", namespaces=_NAMESPACE)
    indices = root.findtext(".//c:triangles/c:p", namespaces=_NAMESPACE)
    colour = root.findtext(".//c:diffuse/c:color", namespaces=_NAMESPACE)
    if not positions or not indices or not colour:
        raise ValueError("the COLLADA text has no positions, no triangles or no colour")
    return TriangleSurface(
        np.array(positions.split(), dtype=float).reshape(-1, 3),
        np.array(indices.split(), dtype=int).reshape(-1, 3),
        np.array(colour.split(), dtype=float)[:3],
    )
