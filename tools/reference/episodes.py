"""The page of the files of an episode."""

from __future__ import annotations

from tools.reference import markdown, sources

INTRO = """What is in the files that [refinement](../handbook/refinement.md) learns from? Each is a numpy archive \
without pickled objects, `episode_<UTC date>T<time>_<ms>.npz`, written under a temporary name and renamed.

n frames; images of side x side pixels; maps of m x m. Poses are matrices `T_a_b` [m], frame b in a; times are seconds \
since the epoch. Every frame has the episode's grasp as its label, so split data by episode, never by frame."""

CONTENT = {
    "meta": "JSON: `schema`, `version`, `revision`, `date`, `operator`, `object`, `source` (execution, teleoperation, "
    "shown), `reason` of the label, `configuration` of the rig with its `fingerprint` (SHA-256), `camera`",
    "camera_K": "matrix of the real camera, or of the virtual one above the table",
    "camera_D": "its distortion",
    "camera_R": "its rectification",
    "camera_P": "its projection",
    "crop": "window of its image: first row, first column, side [px]",
    "T_flange_tool": "the tool",
    "T_tool_grasp": "the point between the fingers: x through them, z the approach",
    "T_base_tool_closed": "label: the measured tool when the fingers had closed",
    "T_base_tool_shown": "label of the source `shown`: the desired tool at that moment; else NaN",
    "T_base_grasp": "what training reads: the tool of the label times `T_tool_grasp`",
    "t_grasp": "when the fingers had closed [s]",
    "held": "whether the hand held the object when it was lifted",
    "lift": "probability of a lift that the executed proposal had; else NaN",
    "stamp": "of the depth images [s]",
    "depth": "[mm], 0 = no reading",
    "maps": "quality, cos, sin, width, before smoothing",
    "mean": "subtracted from the network's input [m]",
    "peak": "GG-CNN's best grasp: row, column, quality, angle, width, in the network's image of 300 x 300",
    "T_base_camera": "optical frame",
    "T_base_tool_measured": "by the measured joints",
    "T_base_tool_desired": "as the operator's hand wanted it; NaN where no hand was followed",
    "finger_angles": "index, middle, thumb, spread [rad], 0 = open",
    "teleop_active": "whether a hand was followed",
}


def page() -> str:
    """Returns the page."""
    sources.on_path()
    from grasping.lab.dataset import store

    rows = []
    for name, (kind, shape) in store.LAYOUT.items():
        size = " x ".join(map(str, shape))
        since = f" (since schema {store.SINCE[name][0]})" if name in store.SINCE else ""
        rows.append([markdown.code(name), {"U": "text", "?": "bool"}.get(kind, kind), size, CONTENT[name] + since])
    head = markdown.generated("Episode files", "grasping.lab.dataset.store", INTRO)
    return f"{head}\n{markdown.table(['array', 'type', 'shape', 'content'], rows)}"
