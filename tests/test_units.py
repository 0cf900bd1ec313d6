"""A length in millimetres is refused wherever a yaml file states one in metres, by the bounds of its schema."""

from __future__ import annotations

import dataclasses
import importlib
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("rig_msgs.srv")
from tools.reference.parameters import SCHEMAS

pytest.importorskip("rospy")
pytestmark = pytest.mark.ros

SOURCE = Path(__file__).parents[1] / "src"
LEAST_M = 0.02  # shorter ones are tolerances, whose thousandfold may be true


def lengths():
    """Yields file, key, value and how a key is read, for each length of our yaml files."""
    for file, parts in SCHEMAS.items():
        whole = yaml.safe_load(next(SOURCE.glob(f"**/{file}")).read_text())
        for part in parts:
            values = whole
            for key in part.path:
                values = values.get(key, {})
            module, name = part.schema.split(":")
            for field in dataclasses.fields(getattr(importlib.import_module(module), name)):
                kind, value = field.metadata["kind"], values.get(field.name)
                if kind.unit == "m" and value is not None and np.abs(value).max() >= LEAST_M:
                    yield f"{file}: {'/'.join((*part.path, field.name))}", value, kind.read


def test_lengths_in_millimetres_are_refused():
    found, taken = list(lengths()), []
    for name, value, read in found:
        read(value)
        try:
            read((1000.0 * np.asarray(value)).tolist())
        except ValueError:
            continue
        taken.append(name)
    assert len(found) > 50 and not taken
