"""The refinement's file: it comes back as it was saved, and says for which rig it is."""

from __future__ import annotations

import io
import json
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

from grasping.network.depth_image import CAMERA, TABLE
from grasping.network.weights import WeightsError
from grasping.refinement import taste
from grasping.refinement.lifts import LiftModel
from grasping.refinement.preference import Preference
from grasping.refinement.refinement_file import ANY_KIND, TERMS, Origin, content, load, of_kind

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


def trained(lifts: bool = True, seed: int = 1) -> Preference:
    rng = np.random.default_rng(seed)
    model = LiftModel(*(rng.uniform(0.1, 1.0, n) for n in (TERMS, TERMS, TERMS + 1))) if lifts else None
    hand = taste.HandStyle(*(rng.normal(0.0, 0.1, n) for n in (2, 3, 3, 2)), 0.1, 0.01)
    weights = rng.normal(0.0, 1.0, len(taste.nobody().weights))
    return Preference(taste.Taste(weights, rng.normal(0.0, 0.01, 3), 0.006, 0.1, hand), model)


KINDS = {"cup": trained(seed=2), "bottle": trained(lifts=False, seed=3)}


def is_the_same(found: Preference, known: Preference):
    assert (found.lifts is None) == (known.lifts is None)
    of = ((known.taste, found.taste), (known.taste.hand, found.taste.hand), (known.lifts or (), found.lifts or ()))
    for one, other in of:
        for a, b in zip(one, other):
            if not isinstance(a, taste.HandStyle):
                np.testing.assert_allclose(a, b, rtol=1e-6)


def test_each_kind_comes_back_as_it_was_saved():
    kinds, origin = load(file(content(KINDS, RIG)))
    assert origin == RIG
    assert list(kinds) == list(KINDS)
    for name, known in KINDS.items():
        is_the_same(kinds[name], known)


@pytest.mark.parametrize("lifts", [True, False], ids=["constrained", "free"])
def test_a_file_of_before_there_were_kinds_comes_back_as_one_of_any(lifts):
    known = trained(lifts)
    state = {key.partition("/")[2] or key: value for key, value in content({"cup": known}, RIG).items()}
    state["about"] = about(json.dumps({"version": 3, **asdict(RIG)}))
    kinds, origin = load(file(state))
    assert origin == RIG
    assert list(kinds) == [ANY_KIND]
    is_the_same(of_kind(kinds, ""), known)


def test_a_kind_is_chosen_by_its_name_and_the_only_one_without():
    kinds, _ = load(file(content(KINDS, RIG)))
    for name, known in KINDS.items():
        is_the_same(of_kind(kinds, name), known)
        is_the_same(of_kind({name: kinds[name]}, ""), known)


@pytest.mark.parametrize("name", ["", "mug", ANY_KIND])
def test_a_kind_that_a_file_lacks_is_refused_with_those_that_it_has(name):
    with pytest.raises(WeightsError) as refused:
        of_kind(KINDS, name)
    assert str(refused.value) == f"refinement_kind is {name!r}, but must be one of cup, bottle."


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


def bad(key, value):
    return {**content({"cup": trained()}, RIG), key: value}


def about(text: str) -> torch.Tensor:
    return torch.tensor(list(text.encode()))


def of_kinds(kinds) -> dict:
    """The content of a file whose text names these kinds."""
    return bad("about", about(json.dumps({"version": 4, "kinds": kinds, **asdict(RIG)})))


OLD = {"first.weight": torch.zeros(32, 10), "offset": torch.zeros(7), "about": about('{"version": 2}')}


WITHOUT_MISS = {k: v for k, v in content({"cup": trained()}, RIG).items() if k != "0/miss"}


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"nothing", "The torch file cannot be read"),
        (file({}), "neither a state dict nor a model"),
        (file({"a": torch.zeros(3)}), "of version 4"),
        (file(OLD), "of version 4"),
        (file(bad("about", about('{"version": 5}'))), "of version 4"),
        (file(bad("about", about("[1"))), "of version 4"),
        (file(bad("about", torch.tensor([300, -1]))), "of version 4"),
        (file(bad("about", torch.tensor([[1.0, np.nan]]))), "of version 4"),
        (file(bad("about", about('{"version": 4, "kinds": ["cup"]}'))), "does not say of what rig it is"),
        (file(content({"cup": trained()}, replace(RIG, view="above"))), "or names a view that is not known"),
        *(
            (file(of_kinds(kinds)), "does not name the kinds of object")
            for kinds in (None, [], ["cup", "cup"], [["cup"]], [""])
        ),
        (file(of_kinds(["cup", "mug"])), "lacks or adds to a refinement: 1/line, 1/miss, "),
        (file(WITHOUT_MISS), "lacks or adds to a refinement: 0/miss"),
        (file(bad("0/miss", torch.zeros(2))), "The array 0/miss has the shape"),
        (file(bad("0/line", torch.full((2,), np.nan))), "not finite"),
        (file(bad("0/spreads", torch.tensor([0.01, 0.1, 0.0, 0.01]))), "not positive"),
        (file(bad("0/lift_scale", torch.zeros(TERMS))), "not positive"),
    ],
    ids=lambda value: value if isinstance(value, str) else "file",
)
def test_bad_files_are_refused(data, sentence):
    with pytest.raises(WeightsError, match=sentence):
        load(data)


def test_another_hash_is_refused():
    with pytest.raises(WeightsError, match="but 00 was expected"):
        load(file(content({"cup": trained()}, RIG)), "00")
