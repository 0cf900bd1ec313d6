"""How the rig's cost grows: with the rate of tracking frames, with subscribers, with a camera, with objects."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from bench.bench_demo import GOALS, DemoRun, run_demo
from bench.bench_leap import simulated_texts
from bench.measure import Row, number
from rig_simulation.files import read_scene
from rig_simulation.world.model import WorldDescription
from rig_simulation.world.physics import World

NOMINAL_HZ = 115.3
RATES = ((4, 1.0), (2, 1.0), (1, 1.0), (1, 1.735))  # every so manieth frame of a recording, and its playback speed
TEXTS = 3000
STAGE = next(iter(GOALS))
OBJECTS = (0, 1, 4, 8)
STEPS, SETTLING = 2000, 300
LISTENER = (
    sys.executable,
    "-c",
    """if True:
    import rospy
    from leap_motion.msg import Human
    from tf2_msgs.msg import TFMessage
    rospy.init_node("bench_listener", anonymous=True)
    rospy.Subscriber("leap_motion/leap_device", Human, lambda m: None)
    rospy.Subscriber("/tf", TFMessage, lambda m: None)
    rospy.spin()
    """,
)


def rows(quick: bool) -> list[Row]:
    """Returns CPU shares and delays as each of them grows.

    Raises:
        BenchError: a demo did not run to its end, or found a fault.
    """
    slices = 3 if quick else 8
    table = []
    with tempfile.TemporaryDirectory() as folder:
        recording, texts = Path(folder) / "frames.jsonl", simulated_texts(TEXTS)
        for every, speed in RATES[-2:-1] if quick else RATES:
            recording.write_text("\n".join(texts[::every]) + "\n")
            demo = run_demo(slices, "--recording", str(recording), "--", f"leap_args:=--loop --rate {speed:g}")
            table += _rows(f"{NOMINAL_HZ / every * speed:.0f} frames/s", demo)
    if not quick:
        for count in (1, 3):
            table += _rows(f"{count} more subscribers", run_demo(slices, beside=[LISTENER] * count))
        table += _rows("with camera", run_demo(slices, "--", "camera:=true"))
    return table + [_objects(count, 200 if quick else STEPS) for count in OBJECTS]


def _rows(name: str, run: DemoRun) -> list[Row]:
    how = f"a demo of {run.report['duration_s']:.0f} s"
    delay = run.report["delay_ms"][STAGE]
    table = [
        number(f"{name}: CPU, the rig", run.busy, "%", how),
        Row(f"{name}: frame to goal", delay["p50"], delay["p99"], "ms", how),
        number(f"{name}: flange on tf", run.flange_rate, "Hz", how),
    ]
    if "frames" in name:
        nodes = ("leap_teleop.py", "real_time_controller.py")
        shares = [float(np.median(run.shares.get(node, np.zeros(1)))) for node in nodes]
        table.append(number(f"{name}: CPU, driver to arm", sum(shares), "%", f"{how}: {', '.join(nodes)}"))
    return table


def _objects(count: int, steps: int) -> Row:
    """Returns the CPU share of the physics with boxes that stand on the table."""
    scene = read_scene("empty")
    box = read_scene("objects")["objects"]["box"]
    places = ((0.15 * (i % 4) - 0.2, 0.15 * (i // 4)) for i in range(count))
    scene["objects"] = {f"box{i}": {**box, "position": list(place)} for i, place in enumerate(places)}
    world = World(WorldDescription("LBR7R800", "MF_elektrisch", (0.0, 0.0, 0.0), scene))
    for _ in range(SETTLING):
        world.step()
    began = time.process_time()
    for _ in range(steps):
        world.step()
    share = 100.0 * (time.process_time() - began) / (steps * world.timestep)
    return number(f"{count} objects: CPU, physics alone", share, "%", f"{steps} steps of {1e3 * world.timestep:g} ms")
