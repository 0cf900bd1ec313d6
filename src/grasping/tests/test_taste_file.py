"""The file of tastes: it comes back as it was saved, and says for which rig and network of lifts it is."""

from __future__ import annotations

import io
import json
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

from grasping.network.depth_image import CAMERA, TABLE
from grasping.network.weights import WeightsError
from grasping.poses.taste import PoseTaste, Style, nobody
from grasping.poses.taste_file import ANY_KIND, VERSION, Origin, TasteFile, content, load, of_kind

RIG = Origin(
    view=CAMERA,
    crop={"side": 400, "rows_up": 0},
    network="ab" * 32,
    robot="LBR7R800",
    hand=np.eye(4).tolist(),
    lifts="cd" * 32,
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


def taste(seed: int) -> PoseTaste:
    rng = np.random.default_rng(seed)
    style = Style(*(rng.normal(0.0, 0.1, n) for n in (2, 3, 3, 2, 2)))
    weights = rng.normal(0.0, 1.0, len(nobody().weights))
    return PoseTaste(weights, rng.normal(0.0, 0.01, 2), style, rng.uniform(0.01, 0.1, 4))


KINDS = {"cup": taste(2), "bottle": taste(3)}


def saved(origin: Origin = RIG, **kinds: PoseTaste) -> dict:
    return content(TasteFile(kinds or KINDS, origin))


def is_the_same(found: PoseTaste, known: PoseTaste):
    for a, b in zip((*found.style, *found[:2], found.spreads), (*known.style, *known[:2], known.spreads)):
        np.testing.assert_allclose(a, b, rtol=1e-6)


def test_each_kind_comes_back_as_it_was_saved():
    kinds, origin = load(file(saved()))
    assert origin == RIG
    assert list(kinds) == list(KINDS)
    for name, known in KINDS.items():
        is_the_same(kinds[name], known)
        is_the_same(of_kind(kinds, name), known)
        is_the_same(of_kind({name: kinds[name]}, ""), known)


@pytest.mark.parametrize("name", ["", "mug", ANY_KIND])
def test_a_kind_that_a_file_lacks_is_refused_with_those_that_it_has(name):
    with pytest.raises(WeightsError) as refused:
        of_kind(KINDS, name)
    assert str(refused.value) == f"refinement_kind is {name!r}, but must be one of cup, bottle."


def test_the_origin_is_what_matters_of_a_rigs_configuration():
    found = Origin.of(CONFIGURATION, "cd" * 32)
    assert found == replace(RIG, view=TABLE, crop=None, table={"extent": 0.65, "distance": 0.7})
    assert Origin.of({**CONFIGURATION, "view": CAMERA}, "cd" * 32) == RIG
    assert Origin.of({"robot": "LBR7R800"}) == Origin(view=CAMERA)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("view", TABLE),
        ("crop", {"side": 300, "rows_up": 0}),
        ("network", "cd" * 32),
        ("robot", "LBR14R820"),
        ("hand", np.diag([1.0, -1.0, -1.0, 1.0]).tolist()),
        ("lifts", "ab" * 32),
    ],
)
def test_another_rig_is_named(name, value):
    found = RIG.mismatch(replace(RIG, **{name: value}))
    assert found.startswith(f"learned with {name}: ")
    assert f", but {name} is " in found
    assert not RIG.mismatch(RIG)
    assert not RIG.mismatch(replace(RIG, **{name: None}))


def bad(key, value):
    return {**saved(cup=taste(1)), key: value}


def about(**changes) -> torch.Tensor:
    text = json.dumps({"version": VERSION, "kinds": ["cup"], **asdict(RIG), **changes})
    return torch.tensor(list(text.encode()))


OLD_LOGIT = {"0/weights": torch.zeros(18), "0/lift_weights": torch.zeros(52), "about": about(version=4)}
WITHOUT_MISS = {k: v for k, v in bad("0/miss", None).items() if k != "0/miss"}


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"nothing", "The torch file cannot be read"),
        (file({}), "neither a state dict nor a model"),
        (file({"a": torch.zeros(3)}), "of version 5"),
        (file(OLD_LOGIT), "of version 5: train it again on the same episodes with train_refinement.py"),
        (file(bad("about", torch.tensor(list(b"[1")))), "of version 5"),
        (file(bad("about", torch.tensor([300, -1]))), "of version 5"),
        (file(bad("about", torch.tensor([[1.0, np.nan]]))), "of version 5"),
        (file(bad("about", torch.tensor(list(b'{"version": 5, "kinds": ["cup"]}')))), "does not say of what rig it is"),
        (file(saved(replace(RIG, view="above"))), "or names a view that is not known"),
        (file(saved(replace(RIG, lifts=None))), "does not say with which network of lifts"),
        *(
            (file(bad("about", about(kinds=kinds))), "does not name the kinds of object")
            for kinds in (None, [], ["cup", "cup"], [["cup"]], [""])
        ),
        (file(bad("about", about(kinds=["cup", "mug"]))), "lacks or adds to tastes: 1/miss, "),
        (file(WITHOUT_MISS), "lacks or adds to tastes: 0/miss"),
        (file(bad("2/miss", torch.zeros(2))), "lacks or adds to tastes: 2/miss"),
        (file(bad("0/miss", torch.zeros(3))), "The array 0/miss has the shape"),
        (file(bad("0/style_line", torch.full((2,), np.nan))), "not finite"),
        (file(bad("0/spreads", torch.tensor([0.01, 0.1, 0.0, 0.01]))), "not positive"),
    ],
    ids=lambda value: value if isinstance(value, str) else "file",
)
def test_bad_files_are_refused(data, sentence):
    with pytest.raises(WeightsError, match=sentence):
        load(data)


def test_another_hash_is_refused():
    with pytest.raises(WeightsError, match="but 00 was expected"):
        load(file(saved()), "00")
