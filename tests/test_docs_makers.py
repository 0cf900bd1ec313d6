"""The generators of the handbook, step by step, on small inputs."""

from __future__ import annotations

import subprocess

import cv2
import numpy as np
import pytest
from PIL import Image

from tools import pictures
from tools.reference import markdown


def test_cells_cannot_break_a_table():
    table = markdown.table(["a"], [["one | two\nthree"]])
    assert table == "| a |\n|---|\n| one \\| two three |\n"


def test_markdown_sees_nothing_of_its_own_in_text():
    assert markdown.text("*a_b* <c> [d](e)") == "\\*a\\_b\\* \\<c\\> \\[d\\](e)"


def test_a_scenario_that_fails_leaves_its_picture_alone(tmp_path, monkeypatch):
    picture = tmp_path / "sheet.png"
    picture.write_text("before")

    def record(scenario, file, options, robots):
        file.write_text("after")
        if fails:
            raise subprocess.CalledProcessError(1, scenario)

    monkeypatch.setattr(pictures, "_record", record)
    monkeypatch.setattr(pictures, "PICTURES", tmp_path)
    fails = True
    with pytest.raises(subprocess.CalledProcessError):
        pictures._sheet("pick_cup", "sheet.png")
    assert picture.read_text() == "before"
    fails = False
    pictures._sheet("pick_cup", "sheet.png")
    assert picture.read_text() == "after"


def test_a_film_plays_faster_as_an_animated_image(tmp_path):
    film = cv2.VideoWriter(str(tmp_path / "film.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 25.0, (64, 48))
    for number in range(125):
        image = np.zeros((48, 64, 3), dtype=np.uint8)
        image[:, number % 60 : number % 60 + 4] = 255
        film.write(image)
    film.release()
    pictures._animate(tmp_path / "film.mp4", tmp_path / "film.webp", begin_s=1.0, end_s=3.0)
    with Image.open(tmp_path / "film.webp") as animated:
        assert animated.n_frames == pytest.approx(2.0 / pictures.FILM_SPEED / (1e-3 * pictures.FILM_FRAME_MS), abs=1)
