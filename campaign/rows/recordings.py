"""Row 80: a recording of another robot."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

from campaign.trial import row
from leap_rig.recording.recording_files import MANIFEST

OTHERS = {
    "robot": "LBR14R820",
    "tool_length": 0.116,
    "dh_parameters": "/another/arm.yaml",
    "tcp_speed": 0.3,
    "z_lower_limit": 0.1,
}
"""What may differ between two rigs: model, tool, calibration and limits."""


def replay(trial, folder: Path) -> Any:
    """Replays on the robot, with an operator who agrees to all; what it says is heard."""
    ended = trial.rig.answer("yes\nno\n", "rosrun", "leap_rig", "replay.py", str(folder), "--robot")
    for line in ended.stderr.splitlines():
        trial.rig.hear("replay.py", line)
    return ended


@row(80, "Replay of a recording on another robot/tool", "R", within=60.0,
     named_by="this is not the robot of the recording",
     dangerous="the path was free for another robot, another tool and other limits", hazards=(23,))  # fmt: skip
def replay_on_another_robot(trial):
    rig = trial.rig
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder, "run")
        recorder = rig.run("leap_rig", "record.py", str(run))
        rig.wait(lambda: "frames" in recorder.log_path.read_text(), "the recorder", 20.0)
        trial.follow(sway=False)
        rig.hand.glide(1.5, right=0.06, up=0.05)
        rig.settle()
        rig.end_program(recorder)
        rig.hand.hide()
        rig.wait_for_modes("servo", "home")
        rig.wait(lambda: rig.stream_state == "waiting", "the end of the stream")
        trial.begins()
        start, goals = rig.arm.now.time, rig.arm.now.goals
        manifest = json.loads((run / MANIFEST).read_text())
        groups = manifest["robot"].values()
        for key, value in OTHERS.items():
            next(group for group in groups if key in group)[key] = value
        (run / MANIFEST).write_text(json.dumps(manifest))
        ended = replay(trial, run)
        trial.check("it is refused", ended.returncode == 1, (ended.returncode, ended.stdout))
        for key, value in OTHERS.items():
            trial.check(f"{key} is named", f"{key} was {value}" in ended.stderr, ended.stderr)
        still = rig.arm.way(start) < 2e-3 and rig.arm.now.goals == goals
        trial.check("the arm stands", still, rig.arm.way(start))
