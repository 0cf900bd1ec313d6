"""The generators of the handbook, step by step, on small inputs."""

from __future__ import annotations

import subprocess
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from PIL import Image

from tools import docs_hooks, pictures
from tools.reference import field_reports, launch_files, markdown, parameters
from tools.reference.sources import ROOT


def test_cells_cannot_break_a_table():
    table = markdown.table(["a"], [["one | two\nthree"]])
    assert table == "| a |\n|---|\n| one \\| two three |\n"


def test_markdown_sees_nothing_of_its_own_in_text():
    assert markdown.text("*a_b* <c> [d](e)") == "\\*a\\_b\\* \\<c\\> \\[d\\](e)"


def test_comments_are_found_by_the_keys_that_lead_there():
    text = "# head\na: 1  # first\nb:\n  c: '#no'  # second\n  d:\n    e: 2\nf: 3  # third\n"
    assert parameters._comments(text) == {("a",): "first", ("b", "c"): "second", ("f",): "third"}


def test_reports_are_found_in_docstrings():
    code = '''def test_x():
    """One.

    Reported in https://github.com/a/b/issues/1, https://github.com/a/b/pull/22: it
    fails. Tried: a file. Reported in https://github.com/c/d.e/issues/3: no. Tried: it.
    """
'''
    first, second = field_reports.reports(code)
    assert first[0] == "test_x" and first[2:] == ("it fails.", "a file") and second[2:] == ("no.", "it")
    assert field_reports.links(first[1]).startswith("[b#1](https://github.com/a/b/issues/1), [b#22](")
    assert field_reports.page().count("| [") > 60


def test_a_fixed_argument_is_no_argument(tmp_path):
    file = tmp_path / "x.launch"
    file.write_text(
        "<launch><!-- What it is. --><arg name='a' default='1' doc='d'/><arg name='b' value='2'/>"
        "<arg name='c' doc=''/></launch>"
    )
    assert list(launch_files.arguments(file)) == ["a", "c"]
    assert launch_files._comment(file) == "What it is."
    assert [launch_files._default(arg) for arg in launch_files.arguments(file).values()] == ["`1`", "must be given"]


@pytest.mark.parametrize(
    ("source", "text", "shown"),
    [
        ("index.md", "[other](faults.md)", "[other](faults.md)"),
        ("index.md", "[how](../CONTRIBUTING.md)", "how (`CONTRIBUTING.md`)"),
        ("vision/a.md", "[x](../faults.md#y) [a.py](../../src/a.py)", "[x](../faults.md#y) `src/a.py`"),
        ("index.md", "![picture](../x.png)", "![picture](../x.png)"),
    ],
)
def test_on_the_site_links_out_of_it_are_places_in_the_repository(source, text, shown):
    page = SimpleNamespace(file=SimpleNamespace(src_uri=source))
    assert docs_hooks.on_page_markdown(text, page, None, None) == shown


def test_a_pattern_in_the_navigation_stands_for_its_pages():
    expanded = docs_hooks._expanded([{"Decisions": "decisions/*.md"}, "index.md"], ROOT / "docs")
    first, *others = expanded[0]["Decisions"]
    assert first == "decisions/README.md" and "decisions/calibrated-arm.md" in others and others == sorted(others)
    assert expanded[1] == "index.md"


def test_a_picture_that_is_none_is_refused_before_any_is_made(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["pictures", *list(pictures.MAKERS)[:1], "nonsense"])
    monkeypatch.setattr(pictures, "MAKERS", dict.fromkeys(pictures.MAKERS, lambda: pytest.fail("it makes pictures")))
    with pytest.raises(SystemExit) as refused:
        pictures.main()
    assert refused.value.code == 2 and "there is no picture nonsense" in capsys.readouterr().err


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
