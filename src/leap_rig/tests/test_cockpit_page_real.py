"""The cockpit's page in a browser, without a rig: by the keyboard alone, at both sizes."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import pytest

from leap_rig.cockpit.server import CockpitServer, ScenePage
from simulated.chromium import browser

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not shutil.which("chromium"), reason="chromium is not installed"),
]
PAGE = Path(__file__).parents[1] / "web" / "cockpit.html"
ROW = {"name": "Limits", "text": "z lower limit", "tone": "warning", "kind": "text", "labels": [], "values": []}
TICKS = {**ROW, "name": "Start", "kind": "ticks", "labels": ["in the box", "slow"], "values": [1.0, 0.0]}
ARM = {
    "present": True, "control_on": True, "gripper_on": False, "scaling_factor": 1.0, "status_line": "it follows.",
    "tone": "normal", "age": 0.1, "rows": [ROW, {**ROW, "name": "Delay", "text": "35 ms"}, TICKS], "enabling": True,
    "clutch": True, "held": {"enable": False, "clutch": False}, "operator": "",
}  # fmt: skip
CODES = {"Tab": 9, "Enter": 13, "Escape": 27, " ": 32}
OVERLAPS = """(() => {
  const all = [...document.querySelectorAll("section, button")].filter(e => e.offsetParent);
  const boxes = all.map(e => e.getBoundingClientRect()), found = [];
  all.forEach((a, i) => all.forEach((b, j) => {
    const [p, q] = [boxes[i], boxes[j]];
    if (j > i && !a.contains(b) && !b.contains(a) && p.left < q.right - 1 && q.left < p.right - 1
        && p.top < q.bottom - 1 && q.top < p.bottom - 1) found.push([a.id, b.id, a.textContent, b.textContent].join());
  }));
  return found.join("; ");
})()"""


@pytest.fixture()
def page(tmp_path):
    """A function that evaluates JavaScript in the page, with what it is to the server in its attributes."""
    obeyed, stops, said = [], [], []
    scene = ScenePage(b"<!doctype html><body tabindex=0>scene", ("127.0.0.1", 9))
    server = CockpitServer(PAGE, scene, ("",), obeyed.append, lambda: stops.append(1), said.append)
    folder = tmp_path / "browser"
    folder.mkdir()

    def until(condition, seconds=30.0, what="it"):
        deadline = time.monotonic() + seconds
        while not (found := condition()):
            assert time.monotonic() < deadline, f"waited for {what}"
            arm = {**ARM, "held": dict(zip(("enable", "clutch"), server.held()[""]))}
            server.put_state({
                "arms": {"": arm}, "answer": {"number": 0, "text": "", "tone": "normal"}, "recording": "",
                "tutorial": {"runs": False, "text": ""},
            })  # fmt: skip
            time.sleep(0.05)
        return found

    def key(kind, name):
        text = {"text": "\r" if name == "Enter" else name} if kind == "keyDown" and name in ("Enter", " ") else {}
        code = "Space" if name == " " else name
        evaluate.call(
            "Input.dispatchKeyEvent", type=kind, key=name, code=code, windowsVirtualKeyCode=CODES[name], **text
        )

    def press(name):
        key("keyDown", name)
        key("keyUp", name)

    try:
        with browser(server.address, folder, until, "1280,943") as evaluate:
            evaluate.server, evaluate.obeyed, evaluate.stops = server, obeyed, stops
            evaluate.until, evaluate.key, evaluate.press = until, key, press
            until(lambda: evaluate("typeof state === 'object' && state !== null"), what="the state")

            def enter():
                evaluate("document.getElementById('code').focus()")
                evaluate.call("Input.insertText", text=said[-1].split()[-1].rstrip("."))
                press("Enter")
                until(lambda: evaluate("admitted"), what="the key")

            evaluate.enter = enter
            yield evaluate
    finally:
        server.close()


def held(page, enable, clutch):
    page.until(lambda: page.server.held()[""] == (enable, clutch), what=f"{enable}, {clutch}")
    shown = "(({enable, clutch}) => [enable, clutch])(state.arms[''].held)"
    page.until(lambda: page(shown) == [enable, clutch], what="the page to show it")


def test_by_the_keyboard_alone_code_control_holding_and_stop(page):
    page.press("Tab")
    assert page("document.activeElement.id") == "stop"
    page.press("Escape")
    page.until(lambda: "code first" in page("$('said').textContent"))
    assert not page.stops
    page.enter()
    page("$('take').focus()")
    page.press("Enter")
    page.until(lambda: page.server.controlled and page("!document.querySelector('.enable').disabled"))
    page("document.querySelector('.enable').focus()")
    page.key("keyDown", " ")
    held(page, True, False)
    page.key("keyUp", " ")
    held(page, False, False)
    page.key("keyDown", " ")
    held(page, True, False)
    page("document.hasFocus = () => false")
    held(page, False, False)
    page("delete document.hasFocus")
    page.until(lambda: page("!document.querySelector('.control').disabled"))
    page("document.querySelector('.control').focus()")
    page.press("Enter")
    page.until(lambda: page.obeyed)
    assert page.obeyed[0][:3] == ("control", "", False)
    page("$('view').contentWindow.focus()")
    page.press("Escape")
    page.until(lambda: page.stops)


@pytest.mark.parametrize("size", [(1280, 800), (390, 844)])
def test_nothing_overlaps_and_the_stop_is_in_view(page, size, tmp_path):
    width, height = size
    page.enter()
    page.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 700)
    page.until(lambda: page("innerWidth") == width and page("document.querySelector('#limits dd') !== null"))
    assert page("document.documentElement.scrollWidth") <= width
    box = "$('stop').getBoundingClientRect()"
    assert page(f"{box}.top") >= 0 and page(f"{box}.bottom") <= height
    stop_is_fixed = width < 700
    overlaps = [pair for pair in page(OVERLAPS).split("; ") if pair and not (stop_is_fixed and "stop" in pair)]
    assert not overlaps
    assert page("[...document.querySelectorAll('button, input')].every(e => e.textContent || e.ariaLabel)")


def test_what_is_old_is_grey_and_says_its_age(page):
    page.until(lambda: page("$('state').textContent").endswith("it follows."))
    time.sleep(2.0)
    assert page("$('state').className") == "old"
    assert page("$('who').textContent").startswith("No news for")
    page.until(lambda: page("$('state').className") == "")
