"""The pages about safety: tests and rows of the campaign show each hazard, and figures can be recalculated."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from campaign.page import CATALOGUE
from tools.reference import evidence

ROOT = Path(__file__).parents[1]
HANDBOOK = ROOT / "docs/handbook"
ARM_KG = 20.0 / 2.0 + 1.12 + 0.5
BODY = {  # stiffness [N/m], mass [kg]
    "hand, fingers": (75e3, 0.6), "forearm": (40e3, 2.0), "upper arm": (30e3, 3.0), "chest": (25e3, 40.0),
    "face": (75e3, 4.4),
}  # fmt: skip


def hazards() -> list[list[str]]:
    """Returns the cells of each line of the table of hazards."""
    table = (HANDBOOK / "safety-case.md").read_text().partition("## Hazards")[2].partition("\n## ")[0]
    return [line.strip("|").split("|") for line in table.splitlines() if re.match(r"\| \d+ \|", line)]


def test_every_row_of_the_campaign_shows_something_of_a_hazard_and_passed():
    rows = evidence.rows()
    assert rows.keys() == set(range(1, CATALOGUE + 1)) and all(rows.values())
    results = json.loads((ROOT / "docs/campaign.json").read_text())
    assert {number: results[str(number)]["result"] for number in rows} == dict.fromkeys(rows, "passed")


def test_something_shows_the_measures_of_each_hazard():
    shown = {hazard for shows in evidence.tests().values() for hazard in shows}
    numbers = {int(row[0]) for row in hazards()}
    assert shown == numbers - {25}, "25 is about devices: no test can show it"
    assert {hazard for shows in evidence.rows().values() for hazard in shows} <= numbers


def test_the_figures_are_those_of_the_code_and_the_configuration():
    from iiwa_kinematics.ptp_speed import PTP_M_PER_S
    from kuka_control.numbers import SPEED_MARGIN
    from leap_kuka.numbers import MAX_SILENCE_S

    kuka = yaml.safe_load((ROOT / "src/kuka_control/config/kuka_params_rt.yaml").read_text())
    page = (HANDBOOK / "safety-case.md").read_text()
    following = f"every point of the arm {kuka['tcp_speed']:g} m/s, joints {100.0 * kuka['joint_speed']:g} %"
    assert re.search(rf"^\| AUT, following a hand \|[^|]*\| {re.escape(following)} \|", page, re.MULTILINE)
    ptp = f"every point {kuka['tcp_speed']:g} m/s at most (PTP controller {PTP_M_PER_S:g} m/s)"
    assert re.search(rf"^\| AUT, PTP motions.*\| {re.escape(ptp)} \|", page, re.MULTILINE)
    assert f"| {SPEED_MARGIN * kuka['tcp_speed']:.2f} m/s at most |" in page
    assert f"lost for {MAX_SILENCE_S:g} s ends it" in page
    sheet = (HANDBOOK / "commissioning.md").read_text()
    slow = yaml.safe_load(re.search(r"```yaml\n(.*?)```", (HANDBOOK / "real-rig.md").read_text(), re.DOTALL).group(1))
    assert slow["velocity_ptp_slow"] == slow["velocity_ptp_fast"]
    expected = f"| {slow['tcp_speed']:g} m/s, {100.0 * slow['velocity_ptp_slow']:g} % |"
    assert any(expected in line for line in sheet.splitlines() if "`slow.yaml` is passed" in line)
    assert f"stays {kuka['time_out']:g} s, then home" in sheet
    assert f"stops {1e3 * kuka['guard_margin']:g} mm before it" in sheet
    assert all(name == "table" for name in kuka["allow_contact"])


def test_every_hazard_has_all_its_cells():
    rows = hazards()
    assert [int(row[0]) for row in rows] == list(range(1, len(rows) + 1)) and len(rows) > 20
    for row in rows:
        assert len(row) == 6 and all(cell.strip() for cell in row), row[0]
        severity, frequency, avoidance, risk = row[3].split()
        points = (severity == "S2", frequency == "F2", avoidance == "P2")
        high, medium = points[0] and (points[1] or points[2]), points in ((False, True, True), (True, False, False))
        assert risk == ("high" if high else "medium" if medium else "low"), row[0]


@pytest.mark.parametrize("motion, velocity", [("joint 1", 0.15), ("joint 2, down", 0.1)])
def test_the_forces_of_contact_are_those_of_the_simulation(motion, velocity):
    from bench import bench_contact

    away, part, height = bench_contact.MOTIONS[motion]
    forces = [
        round(bench_contact.pushed(np.radians(away), part, height, velocity, *case)[0])
        for case in bench_contact.CASES.values()
    ]
    line = f"| {motion} | {velocity:g} | " + " | ".join(map(str, forces)) + " |"
    assert line in (HANDBOOK / "safety-case.md").read_text().splitlines()
    assert forces[0] > 2.0 * forces[2] and forces[1] > forces[2]


def test_the_forces_are_those_of_the_model():
    page = (HANDBOOK / "safety-case.md").read_text()
    for part, (stiffness, mass) in BODY.items():
        per_speed = math.sqrt(stiffness / (1.0 / mass + 1.0 / ARM_KG))
        line = re.search(rf"^\| {part}[^|]*\|(.*)$", page, re.MULTILINE)
        assert line, part
        forces = [int(force) for force in line.group(1).split("|")[:4]]
        assert forces == [round(per_speed * speed) for speed in (0.2, 0.49, 0.65, 0.77)]
        permitted, speed = re.search(r"(\d+) \| (?:below )?([\d.]+) \|$", line.group(1)).groups()
        assert float(speed) == round(float(permitted) / per_speed, 2)
