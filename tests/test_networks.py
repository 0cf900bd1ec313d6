"""The table of bad networks: its page, the choice of cells, and the arm's cells in virtual time."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

from campaign.network import cells, measure
from campaign.network.wire import ROOT

STORED = json.loads((ROOT / "docs" / "bad-networks.json").read_text())
RESULT = {
    **{
        "result": "failed",
        "faults": ["a fault"],
        "goals": 239.6,
        "error_mm": None,
        "joint_speed": 0.4,
        "tool_speed": 0.3,
    },
    **{
        "joint_acceleration": 12.04,
        "pick_ups": 2,
        "stops": 0,
        "recovery": "by itself",
        "recovery_s": 1.26,
        "said": "It waits.",
        "packets": 9,
    },
}


def test_the_page_is_that_of_the_stored_results():
    assert (ROOT / "docs" / "reference" / "bad-networks.md").read_text() == cells.page(STORED)
    assert (ROOT / "docs" / "bad-networks.json").read_text() == cells.as_json(STORED)


def test_no_cell_of_the_table_failed():
    assert {name: result["result"] for name, result in STORED.items()} == dict.fromkeys(STORED, "passed")


def test_a_cell_whose_link_did_nothing_shows_nothing():
    assert "no packet passed" in cells.unprovoked("clear", 0, 0)[0]
    assert "lost no packet" in cells.unprovoked("loss_5", 1000, 0)[0] == cells.unprovoked("down_5", 1000, 0)[0]
    assert not cells.unprovoked("delay_20", 1000, 0) and not cells.unprovoked("loss_1", 1000, 9)
    for name, result in STORED.items():
        assert not cells.unprovoked(name.partition(":")[2], result["packets"], result["lost"]), name


def test_cells_are_chosen_by_name_wire_and_condition():
    assert [cell.number for cell in cells.chosen("arm:loss_5, leap:clear")] == ["arm:loss_5", "leap:clear"]
    assert {cell.wire for cell in cells.chosen("loss_10")} == set(cells.WIRES) - {"afar"}
    assert {cell.wire for cell in cells.chosen("ros")} == {"ros"} and len(cells.chosen("ros")) == 13
    assert cells.chosen("") == list(cells.CELLS.values())
    with pytest.raises(SystemExit, match="no cell 'loss_7'"):
        cells.chosen("loss_7")


def test_a_page_shows_faults_what_was_not_measured_and_what_was_not_run():
    page = cells.page({"arm:loss_5": RESULT, "leap:clear": {"result": "failed", "faults": ["no rig"], "seconds": 0.0}})
    assert "| loss 5 % | 240 | - | 0.40 | 12.0 | 0.30 | 2 | 0 | by itself, 1.3 s | failed |" in page
    assert "- arm:loss_5: a fault\n- leap:clear: no rig" in page and page.count("not run") == 49
    assert "the machine paused for 0.5 s" in cells.line("arm:loss_5", {**RESULT, "pause_s": 0.5})


MODELLED = ("delay_5", "delay_20", "delay_100", "jitter_50", "loss_1", "loss_10", "reordering")


class OperatorsTime:
    """The clock of a measurement, which passes while it waits."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def rig_that_follows(mode: str, follows_from: float, time: OperatorsTime):
    """A rig in that mode, whose arm follows from a time on."""
    answer = SimpleNamespace(success=True)
    return SimpleNamespace(
        mode=mode, modes=[mode], control=lambda on: answer,
        hand=SimpleNamespace(show=lambda **_: None, hide=lambda: None, sway=lambda *_, **__: None),
        arm=SimpleNamespace(now=property_of(lambda: 0.3 if time.now >= follows_from else 0.0)),
    )  # fmt: skip


def property_of(speed):
    return type("Now", (), {"tool_speed": property(lambda _: speed())})()


@pytest.mark.parametrize(
    "mode, follows_from, way, least, most",
    [
        ("servo", 101.0, "followed on", 1.0, 1.1),
        ("servo", 104.0, "hand in again", 4.0, 4.1),
        ("servo", np.inf, "none", 6.0, 30.0),
        ("home", np.inf, "none", 43.0, 44.0),
        ("stopped", np.inf, "none", 20.0, 20.1),
    ],
)
def test_an_operator_waits_for_the_arm_no_longer_than_the_table_says(monkeypatch, mode, follows_from, way, least, most):
    """On any machine: else a cell whose arm does not follow by itself ends by the time-out of its row."""
    time = OperatorsTime()
    monkeypatch.setattr(measure, "clock", time)
    found, seconds = measure._recover(rig_that_follows(mode, follows_from, time))
    assert found == way
    assert least - 0.05 <= seconds <= most


@pytest.mark.ros
@pytest.mark.parametrize(
    "condition",
    ["loss_5", "freezes_300", *(pytest.param(name, marks=pytest.mark.long) for name in MODELLED)],
)
def test_the_arm_keeps_its_limits_on_a_bad_link(virtual_graph, condition):
    from campaign.network.measure import run_cell
    from simulated.rig import VirtualRig

    cell = cells.CELLS[f"arm:{condition}"]
    with VirtualRig(virtual_graph, cell.variant) as rig:
        rig.calm()
        found = run_cell(rig, cell)
    assert found.faults == [], found
