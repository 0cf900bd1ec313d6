"""The cockpit's page in a browser, without a rig: by the keyboard alone, at both sizes."""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import shutil
import time
import urllib.request
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from websockets.sync.client import connect

from leap_rig.cockpit.scene import DRAW_LESS, ONE_ARM, TELL_DRAWN, WORKER, SceneServer
from leap_rig.cockpit.server import MAX_PAGES, CockpitServer, ScenePage
from simulated.chromium import browser
from vision.stereo.transport import Picture

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not shutil.which("chromium"), reason="chromium is not installed"),
]
PAGE = Path(__file__).parents[1] / "web" / "cockpit.html"
SCRIPT = (Path(__file__).parents[2] / "vision" / "web" / "pictures.js").read_bytes()
ROW = {"name": "Limits", "text": "z lower limit", "tone": "warning", "kind": "text", "labels": [], "values": []}
TICKS = {**ROW, "name": "Start", "kind": "ticks", "labels": ["in the box", "slow"], "values": [1.0, 0.0]}
ARM = {
    "present": True, "control_on": True, "gripper_on": False, "scaling_factor": 1.0, "status_line": "it follows.",
    "tone": "normal", "age": 0.1, "rows": [ROW, {**ROW, "name": "Delay", "text": "35 ms"}, TICKS],
    "leap": {"engagement": "relative", "enabling": "device", "clutch": "device"}, "device": "",
    "operator": "anna", "operators": ["", "anna", "bo"],
}  # fmt: skip
CODES = {"Tab": 9, "Enter": 13, "Escape": 27, " ": 32, "ArrowLeft": 37}
OVERLAPS = """(() => {
  const all = [...document.querySelectorAll("section, button")].filter(e => e.offsetParent);
  const rest = document.querySelector("main"), port = rest.getBoundingClientRect(), found = [];
  const boxes = all.map(e => {
    const box = e.getBoundingClientRect(), scrolls = rest.contains(e) && getComputedStyle(rest).overflowY === "auto";
    return {left: box.left, right: box.right, top: scrolls ? Math.max(box.top, port.top) : box.top,
            bottom: scrolls ? Math.min(box.bottom, port.bottom) : box.bottom};
  });
  all.forEach((a, i) => all.forEach((b, j) => {
    const [p, q] = [boxes[i], boxes[j]];
    if (j > i && !a.contains(b) && !b.contains(a) && p.left < q.right - 1 && q.left < p.right - 1
        && p.top < q.bottom - 1 && q.top < p.bottom - 1) found.push([a.id, b.id, a.textContent, b.textContent].join());
  }));
  return found.join("; ");
})()"""


@pytest.fixture(params=[("",)], ids=["one arm"])
def page(tmp_path, request):
    """A function that evaluates JavaScript in the page, with what it is to the server in its attributes."""
    obeyed, stops, said = [], [], []
    echo = b"<script>addEventListener('message', event => parent.postMessage(event.data, '*'))</script>"
    scene = ScenePage(b"<!doctype html><body tabindex=0>scene" + echo, ("127.0.0.1", 9))
    changes, answers = {}, []
    server = CockpitServer(
        PAGE, scene, request.param, obeyed.append, lambda: stops.append(1), said.append, script=SCRIPT
    )
    server.control.fresh_s = 60.0  # a busy machine is slow
    folder = tmp_path / "browser"
    folder.mkdir()

    def until(condition, seconds=120.0, what="it"):
        deadline = time.monotonic() + seconds
        while not (found := condition()):
            assert time.monotonic() < deadline, f"waited for {what}"
            shown = {
                name: {**ARM, **changes, "held": {**asdict(held), "stuck": held.stuck}}
                for name, held in server.held().items()
            }
            server.put_state({
                "arms": shown, "answers": answers, "recording": "",
                "cameras": ["camera"], "only_view": "only_view" in changes, "marks": True,
                "choice": changes.get("choice"),
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
            evaluate.server, evaluate.obeyed, evaluate.stops, evaluate.changes = server, obeyed, stops, changes
            evaluate.answers = answers
            evaluate.until, evaluate.key, evaluate.press = until, key, press
            ready = "typeof stateAt === 'number' && stateAt > 0"
            until(lambda: evaluate(f"{ready} && document.hasFocus()"), what="the page")

            def enter():
                evaluate("document.getElementById('code').focus()")
                code = said[-1].split()[-1].rstrip(".")
                evaluate.call("Input.insertText", text=code)
                assert evaluate("document.getElementById('code').value") == code
                press("Enter")
                until(lambda: evaluate("admitted"), what="the key")

            evaluate.enter = enter
            yield evaluate
    finally:
        server.close()


def held(page, enable, clutch):
    """Waits until that is held. A pause of the machine is a loss, after which a press counts once released: it presses
    again now and then."""
    tries = itertools.count(1)

    def now():
        switches = page.server.held()[""]
        found = (switches.enable, switches.clutch) == (enable, clutch)
        if not found and (enable or clutch) and next(tries) % 20 == 0:
            page.press(" ")
            page.key("keyDown", " ")
        return found

    page.until(now, what=f"{enable}, {clutch}")
    shown = "(({enable, clutch}) => [enable, clutch])(state.arms[''].held)"
    page.until(lambda: page(shown) == [enable, clutch], what="the page to show it")


def without_news(condition):
    """Waits until that is so while the server sends no state."""
    deadline = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_a_policy_and_marks_of_episodes_are_asked_for_where_they_can_be(page):
    leader = {**ROW, "name": "Leader", "text": "policy"}
    page.changes.update(policy=True, rows=[leader, ROW])
    page.enter()
    page("$('take').click()")
    page.until(lambda: page.server.live and page("!document.querySelector('.policy').disabled"), what="control")
    for button in (".policy", ".unled", "[data-mark=discard]", "[data-mark=again]"):
        page(f"document.querySelector('{button}').click()")
    page.until(lambda: len(page.obeyed) == 4, what="the requests")
    assert [(command.name, command.value) for command in page.obeyed] == [
        ("policy", True), ("policy", False), ("mark", ("discard", "")), ("mark", ("again", "")),
    ]  # fmt: skip
    assert page("document.querySelector('.leader').textContent") == "The tool is led by: policy"
    assert page(OVERLAPS) == ""
    page.changes.update(policy=False)
    page.until(lambda: page("!document.querySelector('.policy').offsetParent"), what="no buttons")


def test_by_the_keyboard_alone_code_control_holding_and_stop(page):
    page.press("Tab")
    assert page("document.activeElement.id") == "stop"
    page.press("Escape")
    page.until(lambda: "code first" in page("$('said').textContent"))
    assert not page.stops
    page.enter()
    page("$('take').focus()")
    page.press("Enter")
    page.until(lambda: page.server.live and page("!document.querySelector('.enable').disabled"))
    page("document.querySelector('.enable').focus()")
    page.key("keyDown", " ")
    held(page, True, False)
    page.key("keyUp", " ")
    held(page, False, False)
    page.key("keyDown", " ")
    held(page, True, False)
    page("document.hasFocus = () => false")
    held(page, False, False)
    assert page.until(lambda: not page.server.live, what="the server to hear of the lost focus")
    page("delete document.hasFocus")
    page.until(lambda: page.server.live and page("!document.querySelector('.control').disabled"))
    page("document.querySelector('.control').focus()")
    page.press("Enter")
    page.until(lambda: page.obeyed)
    assert page.obeyed[0][:3] == ("control", "", False)
    page("$('view').contentWindow.focus()")
    page.press("Escape")
    page.until(lambda: page.stops)


def test_the_scene_has_a_process_of_its_own_for_which_the_stop_does_not_wait(page):
    def processes():
        with urllib.request.urlopen(f"http://{page.devtools}/json", timeout=60.0) as answer:
            return [target["url"] for target in json.load(answer) if target["type"] == "iframe"]

    page.until(lambda: any(address.endswith(page.server.scene_path) for address in processes()), what="its process")


def test_in_a_crowd_a_page_sees_all_and_stops_when_it_comes_back_with_its_key(page):
    assert page("control === null"), "without a code it takes no place there"
    paths = ("/state", "/control", "/pictures?camera=camera", page.server.scene_path)
    wire = page.server.address.replace("http", "ws").rstrip("/")
    page.enter()
    page.call("Page.navigate", url="about:blank")
    page.until(lambda: not page.server.watched, what="the page to be gone")
    with contextlib.ExitStack() as stack:
        for path, number in itertools.product(paths, range(MAX_PAGES)):
            machine = (f"127.0.0.{2 + number // 2}", 0)
            stack.enter_context(connect(wire + path, source_address=machine, close_timeout=0.5))
        page.call("Page.navigate", url=page.server.address)
        seen = "typeof admitted === 'boolean' && admitted && state !== null && cameraViews.camera?.source != null"
        picture = Picture(np.zeros((8, 8, 3), np.uint8), 0.0, 0.0, {})
        page.until(lambda: (page.server.put_picture("camera", picture), page(seen))[1], what="state and image")
        ticket = page.server.control.access.ticket
        assert page("$('view').src").endswith(f"{page.server.scene_path}/{ticket}")
        page.press("Escape")
        page.until(lambda: page.stops)


def test_hand_guiding_is_offered_where_the_robot_can_and_pressed_while_it_runs(page):
    page.enter()
    page("$('take').click()")
    hidden = "document.querySelector('.guide').offsetParent === null"
    page.until(lambda: page.server.live and page(hidden))
    page.changes.update(guides=True, guided=False)
    page.until(lambda: not page(hidden) and page("!document.querySelector('.guide').disabled"))
    for on in (True, False):
        page("document.querySelector('.guide').click()")
        page.until(lambda on=on: ("guide", on) in [(each.name, each.value) for each in page.obeyed])
        page.changes["guided"] = on
        page.until(
            lambda on=on: page("document.querySelector('.guide').getAttribute('aria-pressed')") == str(on).lower()
        )


def test_the_operator_is_chosen_while_the_gripper_is_off_and_marks_have_a_text(page):
    page.enter()
    page("$('take').click()")
    page.until(lambda: page.server.live and page("!document.querySelector('.operator').disabled"))
    page.changes["gripper_on"] = True
    page.until(lambda: page("document.querySelector('.operator').disabled"))
    page.changes["gripper_on"] = False
    page.until(lambda: page("!document.querySelector('.operator').disabled"))
    assert page("document.querySelector('.operator').value") == "anna"
    page("(e => { e.value = 'bo'; e.onchange(); })(document.querySelector('.operator'))")
    page("$('note').value = ' slipped '; document.querySelector('[data-mark=failure]').click()")
    page.until(lambda: len(page.obeyed) > 1)
    assert [tuple(command)[:3] for command in page.obeyed] == [
        ("operator", "", "bo"), ("mark", "", ("failure", "slipped")),
    ]  # fmt: skip


def test_a_clutch_that_was_held_when_its_page_was_lost_is_told_and_another_device_hides_the_buttons(page):
    page.enter()
    page("$('take').click()")
    page.until(lambda: page.server.live and page("!document.querySelector('.clutch').disabled"))
    page("document.querySelector('.clutch').focus()")
    page.key("keyDown", " ")
    held(page, False, True)
    stuck = "document.querySelector('.stuck').hidden"
    assert page(stuck)
    page("control.close()")
    page.until(lambda: not page(stuck), what="the sentence")
    assert page("document.querySelector('.stuck').textContent").startswith("The clutch stays pressed")
    page.key("keyUp", " ")
    page.until(lambda: page("admitted"), what="the key again")
    page("$('take').click()")
    page.until(lambda: page.server.live and page("!document.querySelector('.clutch').disabled"))
    assert page.server.held()[""].clutch
    page("document.querySelector('.clutch').focus()")
    page.press(" ")
    held(page, False, False)
    page.until(lambda: page(stuck))
    page.changes["device"] = "/operator_input_node"
    page.until(lambda: page("document.querySelector('.clutch').hidden"))
    assert "/operator_input_node" in page("document.querySelector('.engagement').textContent")


@pytest.mark.parametrize("page", [("",), ("left", "right")], ids=["one arm", "two arms"], indirect=True)
@pytest.mark.parametrize("size", [(1280, 800), (390, 844)])
def test_nothing_overlaps_and_the_stop_is_in_view(page, size, tmp_path):
    width, height = size
    page.enter()
    page.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 700)
    page.until(lambda: page("innerWidth") == width and page("document.querySelector('#limits dd') !== null"))
    assert page("document.documentElement.scrollWidth") <= width
    box = "$('stop').getBoundingClientRect()"
    assert page(f"{box}.top") >= 0 and page(f"{box}.bottom") <= height
    assert page(OVERLAPS) == ""
    page("document.querySelector('main').scrollTop = 200")
    assert page(OVERLAPS) == ""
    label = "e.textContent || e.ariaLabel"
    assert page(f"[...document.querySelectorAll('button, input')].every(e => {label})")
    assert page("[...document.querySelectorAll('select')].every(e => e.labels.length === 1)")


def test_the_scene_is_covered_by_a_sentence_until_it_is_drawn(page):
    notice = "$('notice').textContent"
    page.until(lambda: page(notice) == "The scene is loading.")
    for message, begin in (("no WebGL", "The scene needs WebGL"), ("begun", "The robot is not"), ("drawn", "")):

        def heard(message=message, begin=begin):
            page(f"$('view').contentWindow.postMessage({message!r}, '*')")  # it may not have loaded yet
            return page(notice).startswith(begin) and bool(page(notice)) is bool(begin)

        page.until(heard, what=message)
    page("$('view').contentWindow.postMessage('closed', '*')")
    page.until(lambda: page(notice) == "The scene is old.", what="the end of its connection")
    page("$('view').contentWindow.postMessage('connected', '*')")
    page.until(lambda: page(notice) == "", what="its connection")
    without_news(lambda: page(notice).startswith("No news from the rig"))


def test_the_scene_tells_that_its_connection_ended_and_connects_again_without_focus(page):
    page("window.told = []; addEventListener('message', event => told.push(event.data))")
    page("document.body.append(Object.assign(document.createElement('iframe'), {id: 'drawn'}))")
    frame = "document.getElementById('drawn').contentWindow"
    page(f"{frame}.document.write({json.dumps(WORKER.decode())})")
    viser = "onmessage = ({data}) => postMessage({type: data.type === 'retry' ? 'connected' : 'closed'})"
    page(f"window.worker = new ({frame}.Worker)({frame}.URL.createObjectURL(new Blob([{json.dumps(viser)}]))), 0")
    page("worker.postMessage({type: 'set_server'})")
    page.until(lambda: page("told.join()") == "closed,connected", what="both")


def test_a_browser_without_webgl_says_so(page):
    page("window.told = []; addEventListener('message', event => told.push(event.data))")
    page("document.body.append(Object.assign(document.createElement('iframe'), {id: 'drawn'}))")
    frame, none = (
        "document.getElementById('drawn').contentWindow",
        "HTMLCanvasElement.prototype.getContext = () => null",
    )
    page(f"{frame}.{none}")
    page(f"{frame}.document.write({json.dumps(f'<script>{none}</script>' + TELL_DRAWN.decode())})")
    page.until(lambda: page("told.includes('no WebGL')"))


def test_the_scene_says_when_it_is_drawn_how_large_its_view_is_and_when_it_is_old(page, tmp_path):
    scene, folder = SceneServer(), tmp_path / "second"
    server = CockpitServer(PAGE, ScenePage(scene.page, scene.address), ("",), print, print, print)
    folder.mkdir()
    try:
        scene.put_transform("base", "tool", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), math.inf)
        scene.show_axes("tool", 0.3, "tool")
        scene._root = "base"
        scene.update(0.0)
        with browser(server.address, folder, page.until, "1280,943") as evaluate:

            def drawn():
                server.put_state({
                    "arms": {}, "answers": [], "recording": "", "cameras": [], "only_view": False, "choice": None,
                    "marks": False, "tutorial": {"runs": False, "text": ""},
                })  # fmt: skip
                return evaluate("typeof stateAt === 'number' && stateAt > 0 && sceneSays === BEGUN")

            page.until(drawn, what="the scene")
            size = evaluate("[$('view').clientWidth, $('view').clientHeight]")
            page.until(lambda: (eye := scene._eye()) and [eye.width, eye.height] == size, what="its size")
            evaluate("$('stop').focus(), 0")

            def turned():
                drawn()
                (x, y, _), middle = scene._eye().position, ONE_ARM.middle
                return abs(math.atan2(y - middle[1], x - middle[0]) - ONE_ARM.yaw)

            page.until(lambda: turned() < 0.01, what="the view of the start")
            for name in ("Tab", "ArrowLeft"):
                code = {"key": name, "code": name, "windowsVirtualKeyCode": CODES[name]}
                evaluate.call("Input.dispatchKeyEvent", type="keyDown", **code)
                page.until(lambda: evaluate("document.activeElement.id") == "view", what="the focus of the scene")
            page.until(lambda: turned() > 0.1, what="a turn by the keyboard")
            scene.close()
            old = "$('notice').textContent === 'The scene is old.'"
            page.until(lambda: (drawn(), evaluate(old))[1], what="the end of its connection")
            scene = SceneServer()
            server._scene = ScenePage(b"", scene.address)
            page.until(lambda: (drawn(), scene.viewers and not evaluate(old))[1], what="the next connection")
    finally:
        server.close()
        scene.close()


@pytest.mark.parametrize("page", [("left", "right")], indirect=True)
def test_the_arm_that_the_hand_steers_is_chosen_where_a_request_chooses_it(page):
    page.enter()
    page("$('take').click()")
    page.until(lambda: page.server.live)
    assert page("$('choice').hidden")
    page.changes["choice"] = {"names": ["left", "right", "both"], "chosen": "both"}
    page.until(lambda: page("!$('choice').hidden && !document.querySelector('#choice button').disabled"))
    pressed = "[...document.querySelectorAll('#choice [aria-pressed=true]')].map(each => each.value).join()"
    assert page(pressed) == "both"
    page("document.querySelector('#choice [value=left]').click()")
    page.until(lambda: page.obeyed)
    assert page.obeyed[0][:3] == ("choose", "", "left")
    page.changes["choice"] = {"names": ["left", "right", "both"], "chosen": "left"}
    page.until(lambda: page(pressed) == "left")
    page.changes["choice"] = {"names": ["left", "right"], "chosen": "right"}
    page.until(lambda: page("document.querySelectorAll('#choice button').length") == 2)
    assert page(pressed) == "right"
    without_news(lambda: page("$('choice').className") == "old")


def test_where_a_processor_draws_the_scene_it_draws_less(page):
    page("document.body.append(Object.assign(document.createElement('iframe'), {id: 'drawn'}))")
    frame = "document.getElementById('drawn').contentWindow"
    page(f"{frame}.document.write({json.dumps(DRAW_LESS.decode())}), {frame}.document.close()")
    assert page(f"{frame}.location.search") == "?fixedDpr=1"  # headless, Chromium draws by software
    order = page(f"""new Promise(done => {{
      const ask = {frame}.requestAnimationFrame, called = [];
      {frame}.cancelAnimationFrame(ask(() => called.push("cancelled")));
      ask(() => {{ called.push(1); throw new Error("a fault of one leaves the others"); }});
      ask(before => ask(now => done([...called, now - before])));
    }})""")
    assert order[:-1] == [1] and order[-1] > 100.0


def test_what_both_arms_answer_is_shown_and_a_lost_connection_is_no_missing_code(page):
    page.enter()
    page.answers[:] = [
        {"number": 1, "text": "left: it hangs", "tone": "warning"},
        {"number": 2, "text": "right: ended", "tone": "normal"},
    ]  # fmt: skip
    page.until(lambda: page("$('said').innerText") == "left: it hangs\nright: ended")
    page("control.close()")
    page.press("Escape")
    assert page("$('said').textContent").startswith("There is no connection")


def test_a_stop_without_an_answer_is_told(page):
    page.enter()
    page("control.send = text => { if (!text.includes('stop')) WebSocket.prototype.send.call(control, text); }")
    page.press("Escape")
    assert page("$('stopping').textContent").startswith("Emergency Stop: no answer yet.")
    page("control.close()")
    page.until(lambda: page("$('stopping').textContent").startswith("Emergency Stop: not confirmed."))
    assert not page.stops
    page.until(lambda: page("admitted"), what="the key again")
    page.press("Escape")
    page.until(lambda: page("$('stopping').textContent") == "")
    assert page.stops and page("$('said').textContent") == "The Emergency Stop was sent."


def test_what_was_open_before_the_code_is_opened_anew_with_the_ticket(page):
    page.until(lambda: page("typeof cameraViews === 'object' && cameraViews.camera?.socket.readyState === 1"))
    page.enter()
    kept = "[stateSocket, cameraViews.camera.socket].every(({url}) => url.endsWith(sessionStorage.getItem('ticket')))"
    page.until(lambda: page(kept), what="the ticket")
    page("window.before = stateAt, 0")
    page.until(lambda: page("stateAt > before"), what="a state")


def test_a_mistyped_code_leaves_the_key_and_a_right_one_comes_after_a_void_key(page):
    page.enter()
    key = page("sessionStorage.getItem('cockpit')")

    def comes_back_with(code):
        page(f"control.close(), $('code').value = {code!r}, $('enter').requestSubmit(), admitted = false")
        page.until(lambda: page("admitted"), what="the key again")

    comes_back_with("1")
    assert page("sessionStorage.getItem('cockpit')") == key
    page("sessionStorage.setItem('cockpit', 'void')")
    comes_back_with(page.server.control.access.code)
    assert page("sessionStorage.getItem('cockpit')") not in (key, "void")


def test_what_is_old_is_grey_and_says_its_age(page):
    page.until(lambda: page("$('state').textContent").endswith("it follows."))
    without_news(lambda: page("$('state').className") == "old")
    assert page("$('who').textContent").startswith("No news for")
    page.until(lambda: page("$('state').className") == "")


def test_who_sees_the_arm_only_here_enables_only_while_an_image_is_new(page):
    page.enter()
    page("$('take').click()")
    page.until(lambda: page.server.live and page("!document.querySelector('.enable').disabled"))
    page("document.querySelector('.enable').focus()")
    page.key("keyDown", " ")
    held(page, True, False)
    page.changes["only_view"] = True
    held(page, False, False)

    def live():
        now = time.monotonic()
        page.server.put_picture("camera", Picture(np.zeros((48, 64, 3), np.uint8), now, now, {}))
        return page.server.live

    page.until(live, what="control with images")
    page.until(lambda: not page.server.live, what="its end without")


def test_the_newest_image_is_shown_and_an_old_one_is_grey_with_its_age(page):
    level = iter(range(1000))

    def shown(evaluate=page):
        now = time.monotonic()
        image = np.full((48, 64, 3), (0, 100 + next(level) % 100, 0), np.uint8)
        page.server.put_picture("camera", Picture(image, now, now, {}))
        return evaluate("cameraViews.camera && cameraViews.camera.shown > 3 && !cameraViews.camera.old")

    page.until(shown, what="images")
    # Images may come in any order; one that was taken before the one that is shown changes nothing.
    assert page("""(() => {
      const view = cameraViews.camera, image = document.createElement("canvas"), now = performance.now();
      return [[3, 1, 2], [1, 2, 3], [2, 3, 1]].every(order => {
        view.taken = null;
        let newest = -Infinity;
        return order.map(i => now + 0.001 * i - 0.01).every(at => {
          const before = view.shown;
          view.take(image, at, {});
          const isNew = at > newest;
          newest = Math.max(newest, at);
          return view.taken === newest && (view.shown > before) === isNew;
        });
      });
    })()""")
    colour = "Array.from(cameraViews.camera.pen.getImageData(5, 40, 1, 1).data)"
    page.until(lambda: shown() and page(colour)[1] > 90)
    page.until(lambda: page("cameraViews.camera.old"), what="the age")
    page.until(lambda: len(set(page(colour)[:3])) == 1, what="grey")
