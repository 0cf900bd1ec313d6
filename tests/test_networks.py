"""The table of bad networks: its page, the choice of cells, and two short cells on a running rig."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from campaign.network import cells
from campaign.network.wire import ROOT, in_own_network

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
    assert (ROOT / "docs" / "handbook" / "bad-networks.md").read_text() == cells.page(STORED)
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
    assert {cell.wire for cell in cells.chosen("loss_10")} == set(cells.WIRES)
    assert {cell.wire for cell in cells.chosen("ros")} == {"ros"} and len(cells.chosen("ros")) == 13
    assert cells.chosen("") == list(cells.CELLS.values())
    with pytest.raises(SystemExit, match="no cell 'loss_7'"):
        cells.chosen("loss_7")


def test_a_page_shows_faults_what_was_not_measured_and_what_was_not_run():
    page = cells.page({"arm:loss_5": RESULT, "leap:clear": {"result": "failed", "faults": ["no rig"], "seconds": 0.0}})
    assert "| loss 5 % | 240 | - | 0.40 | 12.0 | 0.30 | 2 | 0 | by itself, 1.3 s | failed |" in page
    assert "- arm:loss_5: It waits." in page
    assert "- arm:loss_5: a fault\n- leap:clear: no rig" in page and page.count("not run") == 37
    assert "the machine paused for 0.5 s" in cells.line("arm:loss_5", {**RESULT, "pause_s": 0.5})


@pytest.mark.ros
@pytest.mark.rig
def test_the_arm_keeps_its_limits_on_a_link_that_loses_packets_or_freezes():
    device = [sys.executable, "-c", "from campaign.network.wire import Wire; Wire('arm').close()"]
    if subprocess.run(in_own_network(device), cwd=ROOT, capture_output=True).returncode:
        pytest.skip("this machine lets nobody make a network device")
    from campaign.run import Campaign

    results = Campaign(list(cells.SHORT.values()), 1, None, lambda *_: None).run()
    assert {name: result["faults"] for name, result in results.items()} == {name: [] for name in cells.SHORT}
    assert results["arm:loss_5:short"]["lost"] > 0
