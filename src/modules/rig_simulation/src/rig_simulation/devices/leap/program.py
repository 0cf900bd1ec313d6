"""The program `leapd.py`: options, one line when it is ready, then the service until it is interrupted."""

from __future__ import annotations

import argparse
import functools
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from common.command_line import failed, finite, parse_options, port, positive, stop_on_signals
from common.errors import RigError
from common.poses import pose
from common.rotations import rotation_about
from leap_motion.service import wire
from rig_simulation.devices.leap.sensing import FRAME_RATE
from rig_simulation.devices.leap.server import SimulatedLeapService
from rig_simulation.faults.injection import add_option, switch_all
from rig_simulation.faults.leap import LEAP_FAULTS
from rig_simulation.operator import motion
from rig_simulation.operator.guided import GuidedOperator
from rig_simulation.operator.sources import BothHands, Playback, Recording, ScriptedOperator, Source

NAME = "leapd"
BOTH = "both"
REQUESTS = ("show", "reach", "hide", "hand")


def main(arguments: list[str] | None = None) -> int:
    options = parse(arguments)
    try:
        source, requests = _source(options)
        playback = Playback(source, options.seed, options.service, not options.paused, options.frame_rate)
        ports = options.host, options.port, options.control_port
        service = SimulatedLeapService(playback, *ports, options.service, requests)
    except RigError as error:
        return failed(NAME, error)
    switch_all(service.faults, options.fault)
    stop_on_signals(service.stop)
    control = f"{service.host}:{service.control_port}"
    print(f"{NAME}: listening on {service.host}:{service.port}, control port {control}", flush=True)
    service.run()
    return 0


def _source(options: argparse.Namespace) -> tuple[Source, dict[str, Callable[..., Any]]]:
    """Returns the source of the frames, and its own requests of the control port."""
    if options.recording is not None:
        return Recording(options.recording, options.rate, options.offset, options.loop), {}
    script = motion.Script(options.figure, options.size, options.speed, options.plane, away=options.away)
    T_desk_leap = None
    if any(options.stands):
        pitch, yaw, roll = map(math.radians, options.stands[3:])
        R = rotation_about(1, yaw) @ rotation_about(0, pitch) @ rotation_about(2, roll)
        T_desk_leap = pose(R, options.stands[:3])
    centre, service = tuple(options.centre), (options.service, T_desk_leap, options.frame_rate)
    if options.hand == BOTH:
        x, y, z = centre
        scripts = {
            side: ScriptedOperator(script, side, options.scale, (x + shift, y, z), *service)
            for side, shift in (("left", -options.apart / 2.0), ("right", options.apart / 2.0))
        }
        if not options.guided:
            return BothHands((scripts["left"], scripts["right"]), options.service, options.frame_rate), {}
        both = {side: GuidedOperator(of_side) for side, of_side in scripts.items()}
        source = BothHands((both["left"], both["right"]), options.service, options.frame_rate)
        return source, {name: functools.partial(_of_side, both, name) for name in REQUESTS}
    scripted = ScriptedOperator(script, options.hand, options.scale, centre, *service)
    if not options.guided:
        return scripted, {}
    guided = GuidedOperator(scripted)
    return guided, {name: getattr(guided, name) for name in (*REQUESTS, "second")}


def _of_side(both: Mapping[str, GuidedOperator], name: str, side: str = "", **fields: Any) -> Any:
    """Passes a request on to the hand of its `side`."""
    if side not in both:
        raise ValueError(f"The side is {side!r}, but must be left or right: both hands are there.")
    return getattr(both[side], name)(**fields)


def parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog=f"{NAME}.py", description="Simulated service of the Leap Motion controller.")
    add = parser.add_argument
    add("--host", default="127.0.0.1", help="loopback address to listen on")
    add("--port", type=port, default=6437, help="WebSocket port; 0 takes any free port")
    add("--control-port", type=port, default=16437, help="port for tests; 0 takes any free port")
    add("--paused", action="store_true", help="send empty frames until the control port starts the source")
    add("--seed", type=int, default=0, help="seed of the noise and of the operator's variations")
    add("--service", choices=wire.SERVICES, default="2.3", help="leapd, or the server of Ultraleap's current service")
    rate = "frames per second; those of a recording have their own times"
    add("--frame-rate", type=positive, default=FRAME_RATE, metavar="HZ", help=rate)
    add_option(parser, LEAP_FAULTS)
    xyz = ("X", "Y", "Z")
    add = parser.add_argument_group("a recording").add_argument
    add("--recording", type=Path, metavar="FILE", help="one JSON frame a line, .gz or plain")
    add("--loop", action="store_true", help="start it again, after a pause without hands")
    add("--rate", type=positive, default=1.0, metavar="FACTOR", help="playback speed")
    add("--offset", type=finite, nargs=3, default=(0.0, 0.0, 0.0), metavar=xyz, help="added to positions, mm")
    add = parser.add_argument_group("a scripted operator, without a recording").add_argument
    guided = "the hand goes where the control port sends it: show, reach, hide, second (metres, radians, seconds)"
    add("--guided", action="store_true", help=guided)
    add("--figure", choices=motion.FIGURES, default="circle", help="figure that the hand draws")
    add("--size", type=positive, default=150.0, help="width of the figure, mm")
    add("--speed", type=positive, default=150.0, help="highest speed of the palm, mm/s; people move at 50 to 250")
    add("--plane", choices=sorted(motion.PLANES), default="upright", help="plane of the figure")
    add("--away", type=positive, default=3.0, help="time without a hand between two visits, s")
    which = "which hand; with both, requests of the control port name the side"
    add("--hand", choices=("right", "left", BOTH), default="right", help=which)
    add("--apart", type=positive, default=320.0, help="of both hands' workspaces, mm along the Leap's x axis")
    add("--scale", type=positive, default=1.05, help="size of the hand against the template; adults: 1.03 to 1.10")
    centre = "centre of the hand's workspace, mm in Leap axes"
    add("--centre", type=finite, nargs=3, default=(0.0, 350.0, 0.0), metavar=xyz, help=centre)
    stands = "where the device stands: mm, then deg about x, y (first) and z; the other numbers are the desk's then"
    place = (*xyz, "PITCH", "YAW", "ROLL")
    add("--stands", type=finite, nargs=6, default=(0.0,) * 6, metavar=place, help=stands)
    return parse_options(parser, arguments)
