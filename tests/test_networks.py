"""The table of bad networks: its page, the choice of cells, and the arm's cells in virtual time."""

from __future__ import annotations

import json

import pytest

from campaign.network import cells
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
