"""The checked-in URDF files are those of the generator, and the meshes are closed surfaces of a sensible size."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from rig_description.urdf import all_files

PACKAGE = Path(__file__).parents[1]
MESHES = sorted((PACKAGE / "meshes").rglob("*.dae"))
NAMESPACE = {"c": "http://www.collada.org/2005/11/COLLADASchema"}


def test_checked_in_files_are_the_generators():
    present = {str(path.relative_to(PACKAGE)): path.read_text("utf-8") for path in PACKAGE.glob("urdf/**/*.*")}
    generated = all_files()
    assert present.keys() == generated.keys()
    changed = [name for name, text in generated.items() if present[name] != text]
    assert not changed, "run tools/generate.py and look at the difference"


def test_every_mesh_of_the_urdf_is_there():
    named = {
        mesh.get("filename") for path in PACKAGE.glob("urdf/*.urdf") for mesh in ET.parse(path).getroot().iter("mesh")
    }
    assert named == {f"package://rig_description/{path.relative_to(PACKAGE)}" for path in MESHES}


@pytest.mark.parametrize("path", MESHES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_mesh_is_closed_and_faces_outwards(path):
    tree = ET.parse(path).getroot()
    positions, normals = (
        np.array(tree.find(f".//c:float_array[@id='{name}-array']", NAMESPACE).text.split(), dtype=float).reshape(-1, 3)
        for name in ("positions", "normals")
    )
    triangles = np.array(tree.find(".//c:p", NAMESPACE).text.split(), dtype=int).reshape(-1, 3)
    edges = Counter(map(tuple, np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])))

    assert path.stat().st_size < 100_000
    assert len(normals) == len(positions)
    assert set(triangles.ravel()) == set(range(len(positions)))
    assert set(edges.values()) == {1}, "an edge belongs to two triangles that run along it in opposite directions"
    assert all((b, a) in edges for a, b in edges)
    a, b, c = (positions[triangles[:, i]] for i in range(3))
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0
    box = np.ptp(positions, axis=0).prod()
    assert 0.2 * box < volume < box
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=0.02)
    agree = np.einsum("ij,ij->i", np.cross(b - a, c - a), normals[triangles].sum(axis=1)) > 0.0
    assert agree.mean() > 0.99
