"""RViz and the control panel beside each other, and presets that a processor can draw."""

from __future__ import annotations

import os
from copy import deepcopy
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rospkg")
from common.ros import rviz
from common.screen import panel_area, view_area

PRESET = {"Visualization Manager": {"Global Options": {"Frame Rate": 30, "Fixed Frame": "world"}, "Name": "root"},
          "Window Geometry": {"Width": 1280, "Height": 960, "X": 20}}  # fmt: skip


@given(st.integers(-4000, 4000), st.integers(-100, 4000), st.integers(1000, 8000), st.integers(600, 4000))
def test_rviz_and_the_control_panel_are_whole_and_beside_each_other(left, top, width, height):
    free = (left, top, width, height)
    panel, view = panel_area(*free), view_area(*free)
    assert view[0] + view[2] < panel[0]
    for x, y, wide, high in (panel, view):
        assert left <= x and x + wide <= left + width and wide >= 400
        assert top + 20 <= y and y + high <= top + height and high >= 500


@pytest.mark.parametrize("card", [False, True])
def test_a_preset_is_fitted_and_otherwise_stays(card):
    before = deepcopy(PRESET)
    made = rviz.fitted(PRESET, (4, 32, 700, 760), card)
    assert before == PRESET
    assert made["Window Geometry"] == {"Width": 700, "Height": 760, "X": 4, "Y": 32}
    options = made["Visualization Manager"]["Global Options"]
    assert options == {"Fixed Frame": "world", "Frame Rate": 30 if card else rviz.SLOW_RATE_HZ}
    assert made["Visualization Manager"]["Name"] == "root"
    wide = rviz.fitted(PRESET, (4, 32, 4000, 2000), card)
    assert (wide["Window Geometry"]["Width"], wide["Window Geometry"]["Height"]) == (1280, 960)
    assert rviz.fitted(PRESET, None, True) == PRESET


@pytest.fixture
def preset(tmp_path, monkeypatch):
    """A preset's file, without a graphics card, where Python has no Qt."""
    monkeypatch.setenv("ROS_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(rviz, "has_graphics_card", lambda: False)
    monkeypatch.setattr(rviz, "_view_area", lambda: None)
    file = tmp_path / "rig.rviz"
    file.write_text(yaml.safe_dump(PRESET))
    return file


def test_rviz_starts_with_a_copy_that_nobody_writes(preset, tmp_path):
    for _ in range(2):
        *before, copy, frame, world, plain = rviz.command(["idle", "rviz", "-d", str(preset), "-f", "world"])
        assert before == ["idle", "rviz", "-d"] and (frame, world, plain) == ("-f", "world", rviz.PLAIN)
        assert Path(copy).parent == tmp_path / "home" / "rviz" and not Path(copy).stat().st_mode & 0o222
        assert yaml.safe_load(Path(copy).read_text()) == rviz.fitted(PRESET, None, False)


@pytest.mark.parametrize("text", ["", "a: [", "- 1", "Window Geometry: 3"])
def test_a_preset_that_cannot_be_fitted_is_left_to_rviz(preset, monkeypatch, text):
    monkeypatch.setattr(rviz, "_view_area", lambda: (0, 0, 700, 700))
    preset.write_text(text)
    given = ["rviz", "-d", str(preset)]
    assert rviz.command(given) == [*given, rviz.PLAIN]
    assert rviz.command(["rviz", "-d"]) == ["rviz", "-d", rviz.PLAIN]
    assert rviz.command(["echo", "-n"]) == ["echo", "-n"]


def test_without_a_place_for_the_copy_the_preset_stays(preset, tmp_path):
    (tmp_path / "home").write_text("a file")
    given = ["rviz", "-d", str(preset)]
    assert rviz.command(given) == [*given, rviz.PLAIN]


@pytest.mark.parametrize(("value", "drawn_by_a_card"), [("1", False), ("true", False), ("0", None), ("", None)])
def test_who_asks_for_software_gets_it(monkeypatch, value, drawn_by_a_card):
    from common.screen import has_graphics_card

    monkeypatch.delenv("LIBGL_ALWAYS_SOFTWARE", raising=False)
    there = has_graphics_card()
    monkeypatch.setitem(os.environ, "LIBGL_ALWAYS_SOFTWARE", value)
    assert has_graphics_card() == (there if drawn_by_a_card is None else drawn_by_a_card)
