"""The refinement's file: it comes back as it was saved, and says for which rig it is."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
import torch

from grasping.network.depth_image import CAMERA, TABLE
from grasping.network.weights import WeightsError
from grasping.refinement import taste
from grasping.refinement.lifts import LiftModel
from grasping.refinement.preference import Preference
from grasping.refinement.refinement_file import TERMS, Origin, content, load

RIG = Origin(
    view=CAMERA,
    crop={"side": 400, "rows_up": 0},
    network="ab" * 32,
    robot="LBR7R800",
    hand=np.eye(4).tolist(),
)
CONFIGURATION = {
    "view": TABLE,
    "crop": {"side": 400, "rows_up": 0},
    "table": {"extent": 0.65, "distance": 0.7, "noise": 0.003},
    "weights": "ab" * 32,
    "kuka": {"robot": "LBR7R800", "flange": "MF_elektrisch"},
    "T_tool_grasp": np.eye(4).tolist(),
}


def file(state) -> bytes:
    buffer = io.BytesIO()
    torch.save(state, buffer)
    return buffer.getvalue()


def trained(lifts: bool = True) -> Preference:
    rng = np.random.default_rng(1)
    model = LiftModel(*(rng.uniform(0.1, 1.0, n) for n in (TERMS, TERMS, TERMS + 1))) if lifts else None
    hand = taste.HandStyle(*(rng.normal(0.0, 0.1, n) for n in (2, 3, 3, 2)), 0.1, 0.01)
    weights = rng.normal(0.0, 1.0, len(taste.nobody().weights))
    return Preference(taste.Taste(weights, rng.normal(0.0, 0.01, 3), 0.006, 0.1, hand), model)


@pytest.mark.parametrize("lifts", [True, False], ids=["constrained", "free"])
def test_what_was_saved_comes_back(lifts):
    known = trained(lifts)
    found, origin = load(file(content(known, RIG)))
    assert origin == RIG
    assert (found.lifts is None) != lifts
    of = ((known.taste, found.taste), (known.taste.hand, found.taste.hand), (known.lifts or (), found.lifts or ()))
    for one, other in of:
        for a, b in zip(one, other):
            if not isinstance(a, taste.HandStyle):
                np.testing.assert_allclose(a, b, rtol=1e-6)


def test_the_origin_is_what_matters_of_a_rigs_configuration():
    found = Origin.of(CONFIGURATION)
    assert found == replace(RIG, view=TABLE, crop=None, table={"extent": 0.65, "distance": 0.7})
    assert Origin.of({**CONFIGURATION, "view": CAMERA}) == RIG
    assert Origin.of({"robot": "LBR7R800"}) == Origin(view=CAMERA)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("view", TABLE),
        ("crop", {"side": 300, "rows_up": 0}),
        ("network", "cd" * 32),
        ("robot", "LBR14R820"),
        ("hand", np.diag([1.0, -1.0, -1.0, 1.0]).tolist()),
    ],
)
def test_another_rig_is_named(name, value):
    found = RIG.mismatch(replace(RIG, **{name: value}))
    assert found.startswith(f"learned with {name}: ")
    assert f", but {name} is " in found
    assert not RIG.mismatch(RIG)
    assert not RIG.mismatch(replace(RIG, **{name: None}))


def test_another_extent_of_the_table_is_another_rig():
    one = Origin.of(CONFIGURATION)
    other = Origin.of({**CONFIGURATION, "table": {**CONFIGURATION["table"], "extent": 0.4}})
    assert "learned with table: {'extent': 0.65, 'distance': 0.7}, but table is {'extent': 0.4" in one.mismatch(other)
    finer = Origin.of({**CONFIGURATION, "table": {**CONFIGURATION["table"], "noise": 0.002}})
    assert not one.mismatch(finer)


def bad(key, value):
    return {**content(trained(), RIG), key: value}


def about(text: str) -> torch.Tensor:
    return torch.tensor(list(text.encode()))


OLD = {"first.weight": torch.zeros(32, 10), "offset": torch.zeros(7), "about": about('{"version": 2}')}


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"nothing", "The torch file cannot be read"),
        (file({}), "neither a state dict nor a model"),
        (file({"a": torch.zeros(3)}), "of version 3"),
        (file(OLD), "of version 3"),
        (file(bad("about", about('{"version": 4}'))), "of version 3"),
        (file(bad("about", about("[1"))), "of version 3"),
        (file(bad("about", torch.tensor([300, -1]))), "of version 3"),
        (file(bad("about", torch.tensor([[1.0, np.nan]]))), "of version 3"),
        (file(bad("about", about('{"version": 3}'))), "does not say of what rig it is"),
        (file(content(trained(), replace(RIG, view="above"))), "or names a view that is not known"),
        (
            file({k: v for k, v in content(trained(), RIG).items() if k != "miss"}),
            "lacks or adds to a refinement: miss",
        ),
        (file(bad("miss", torch.zeros(2))), "The array miss has the shape"),
        (file(bad("line", torch.full((2,), np.nan))), "not finite"),
        (file(bad("spreads", torch.tensor([0.01, 0.1, 0.0, 0.01]))), "not positive"),
        (file(bad("lift_scale", torch.zeros(TERMS))), "not positive"),
    ],
    ids=[
        "no torch",
        "empty",
        "foreign",
        "old",
        "newer",
        "torn",
        "codes",
        "nan",
        "bare",
        "view",
        "part",
        "shape",
        "inf",
        "spread",
        "scale",
    ],
)
def test_bad_files_are_refused(data, sentence):
    with pytest.raises(WeightsError, match=sentence):
        load(data)


def test_another_hash_is_refused():
    with pytest.raises(WeightsError, match="but 00 was expected"):
        load(file(content(trained(), RIG)), "00")
