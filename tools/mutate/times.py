"""Times that somebody's safety or patience depends on: each, doubled or quadrupled, must be found by a test."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from tools.mutate.places import Place

FACTORS = (2, 4)
TIMES = {
    "common/src/common/hand_tracking.py": "MAX_SKEW_S LONG_GAP_S REMEMBERED_S",
    "common/src/common/operator_rows.py": "OLD_ROWS_S",
    "leap_kuka/src/leap_kuka/numbers.py": "MAX_SILENCE_S TURN_S HEARTBEAT_S PAUSE_S MEASURED_AGE_S REACH_LOOK_S "
    "REACH_START_S REACH_TIMEOUT_S REACH_FRESH_S DEVICE_SILENCE_S LEFT_S JOY_SILENCE_S DEBOUNCE_S GAP_S",
    "leap_kuka/src/leap_kuka/ros/operator_input_node.py": "PERIOD_S",
    "leap_kuka/src/leap_kuka/ros/teleop_node.py": "WATCH_PERIOD_S",
    "leap_hand/src/leap_hand/teleop.py": "MAX_SILENCE_S MAX_MISSING_S",
    "leap_hand/src/leap_hand/ros/teleop_node.py": "WATCH_PERIOD_S FIRST_STATE_S ANSWER_TIMEOUT_S SETTLING_S",
    "leap_hand/config/leap_hand.yaml": "grip_hold force_limit_silence",
    "kuka_control/config/kuka_params_rt.yaml": "time_out",
    "kuka_control/src/kuka_control/loop/arm.py": "WAIT_S",
    "kuka_control/src/kuka_control/loop/control_loop.py": "EXIT_PATIENCE_S HAND_S BLOCKED_S",
    "kuka_control/src/kuka_control/loop/controller.py": "FIRST_PAUSE_S LONGEST_PAUSE_S NAMED_S OFF_S MISSING_S",
    "kuka_control/src/kuka_control/loop/goal_stream.py": "LOST_S LONGEST_STALL_S CONTINUED_S FADE_S SETTLING_S",
    "kuka_control/src/kuka_control/loop/line_stream.py": "NO_PROGRESS_S",
    "kuka_control/src/kuka_control/loop/servo_law.py": "PATIENCE_S",
    "kuka_control/src/kuka_control/loop/tracking.py": "FAR_S STILL_S UNKNOWN_S HELD_S HELD_AT_ENDS_S END_S",
    "kuka_control/src/kuka_control/model/desired_frame.py": "HANDOVER_S MAX_SKEW_S PAUSE_S STALLED_S REFUSING_S "
    "STANDS_S UNCONNECTED_S",
    "kuka_control/src/kuka_control/ros/controller_node.py": "PATIENCE_S PROBE_S TIMEOUT_S AGAIN_TIMEOUT_S "
    "LONGEST_PERIOD_S BRAKING_S SHUTDOWN_S",
    "kuka_control/src/kuka_control/ros/guard_view.py": "TAKE_S SILENT_S",
    "kuka_control/src/kuka_control/ros/move_program.py": "SERVER_S SILENCE_S",
    "kuka_control/src/kuka_control/ros/moves.py": "START_S",
    "modules/kst/src/kst/client.py": "LATE_END_S",
    "modules/kst/src/kst/session.py": "servo_window silence",
    "modules/leap_motion/src/leap_motion/client.py": "SILENCE_S UNUSABLE_S HEADER_TIMEOUT_S PING_S RETRY_S RETRY_MAX_S",
    "modules/leap_motion/src/leap_motion/device_clock.py": "MAX_WAIT_S",
    "modules/reflex/src/reflex/client.py": "REOPEN_S SPEED_TIMEOUT_S",
    "modules/reflex/config/reflex_takktile.yaml": "silence_time",
    "vision/src/vision/ros/camera/xtion_node.py": "SILENCE_S RETRY_PERIOD_S",
    "vision/config/camera_watchdog.yaml": "silence",
    "vision/src/vision/ros/stereo/web_node.py": "SILENCE_S",
    "grasping/src/grasping/pipeline/tool_pose.py": "RETRY_S",
    "grasping/config/execution.yaml": "silence wait_for_hand",
    "grasping/config/ggcnn.yaml": "max_age silence",
}
"""Files below src, and names in them."""


def find(source: str, package: str, file: str, names: str) -> list[Place]:
    """Returns the places of the names in a file; raises KeyError for one that has no number there."""
    found = dict(_in_yaml(source) if file.endswith(".yaml") else _in_python(source))
    places = []
    for name in names.split():
        offset, text = found[name]
        line = source.count("\n", 0, offset) + 1
        for number, factor in enumerate(FACTORS):
            after = repr(factor * float(text))
            places.append(Place(package, file, line, "", name, f"x{factor}", number, text, after, offset))
    return places


def uses(place: Place, sources: dict[str, str]) -> dict[str, set[int]]:
    """Returns the lines in which a time stands, by file, of those that may import it."""
    module = place.file.rpartition("/src/")[2][: -len(".py")].replace("/", ".")
    able = {file: source for file, source in sources.items() if file == place.file or f"from {module} import" in source}
    name = re.compile(rf"\b{place.statement}\b")
    return {
        file: {number for number, line in enumerate(source.splitlines(), 1) if name.search(line)}
        for file, source in able.items()
    }


def _in_python(source: str) -> Iterator[tuple[str, tuple[int, str]]]:
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, (ast.Assign, ast.AnnAssign)) or node.value is None:
            continue
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        targets = target.elts if isinstance(target, ast.Tuple) else [target]
        values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
        for each, value in zip(targets, values):
            if isinstance(each, ast.Name) and isinstance(value, ast.Constant) and type(value.value) in (int, float):
                offset = starts[value.lineno - 1] + value.col_offset
                yield each.id, (offset, source[offset : starts[value.lineno - 1] + (value.end_col_offset or 0)])


def _in_yaml(source: str) -> Iterator[tuple[str, tuple[int, str]]]:
    for found in reversed(list(re.finditer(r"^ *(\w+): +([0-9.]+)", source, re.MULTILINE))):  # the first one counts
        yield found[1], (found.start(2), found[2])
