"""One client of the simulated robot application: the toolbox's words as the toolbox answers them, and the words of a
client that says hello. No sockets; time is handed in, and each millisecond of it is a cycle of the main thread.
Source: sunrise_application, README and Session.java, whose sentences these are."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from common.poses import read_only
from rig_simulation.devices.sunrise import java_text, motions
from rig_simulation.devices.sunrise import leap_rig_words as words
from rig_simulation.devices.sunrise.application import (
    DONE,
    LAST_WORD_S,
    NAK,
    Application,
    Break,
    Condition,
    ControllerIO,
    Planner,
)
from rig_simulation.devices.sunrise.arm import SimulatedArm
from rig_simulation.devices.sunrise.compliance import Softness
from rig_simulation.devices.sunrise.leap_rig_words import Request
from rig_simulation.devices.sunrise.motions import Goals, pose_from_frame
from rig_simulation.devices.sunrise.paths import JointMove, Unreachable
from rig_simulation.devices.sunrise.robot import CYCLE_S

ABILITIES = "watchdog_stop_contact_tool_soft_float_guide_state"
OLD_CLIENT_SILENT_S = 60.0
BRAKE_RAD_S2 = 10.0
OPERATION_MODE = "AUT"
PAUSE = ""  # why a motion is to end that may be resumed


@dataclasses.dataclass
class Watchdog:
    """After which silences the arm brakes, and servo mode ends [s]."""

    brake: float = 0.2
    end: float = 10.0

    def set(self, brake: float, end: float) -> str | None:
        """Sets both; returns why not, or None."""
        least, most, longest = 0.05, 2.0, 60.0
        no = words.out_of_range("the first time", [brake], least, most)
        if no is not None:
            return no.replace(", but", " s, but")
        if not brake < end <= longest:
            return f"the second time is {java_text.text(end)} s, but must be above the first and at most {longest}"
        self.brake, self.end = brake, end
        return None


@dataclasses.dataclass(frozen=True)
class Mass:
    """A mass [kg] and its centre in the flange frame [mm]."""

    kg: float = 0.0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0

    @property
    def in_metres(self) -> tuple[float, np.ndarray]:
        """The mass [kg] and its centre, shape (3,) [m]."""
        return self.kg, read_only(np.array([self.x, self.y, self.z]) / motions.MM_PER_M)


class Brake:
    """The destinations of joints that come to rest in proportion; from angles q and speeds v, shape (7,)."""

    def __init__(self, q: np.ndarray, v: np.ndarray) -> None:
        self.destination, self._v = q, v

    @property
    def resting(self) -> bool:
        return not self._v.any()

    def advance(self, dt: float) -> None:
        """Advances by a time [s]."""
        fastest, change = float(np.max(np.abs(self._v))), BRAKE_RAD_S2 * dt
        kept = 1.0 - change / fastest if fastest > change else 0.0
        moving = dt if fastest > change else fastest / BRAKE_RAD_S2
        to = self.destination + 0.5 * (1.0 + kept) * self._v * moving
        self.destination = read_only(np.clip(to, -words.RANGES_RAD, words.RANGES_RAD))
        self._v = kept * self._v


class LeapRigApplication(Application):
    """The application with one client, from its first line until it has gone."""

    def __init__(
        self,
        arm: SimulatedArm,
        io: ControllerIO,
        session: int = 0,  # the number that a second connection names
        encoders: Callable[[np.ndarray], np.ndarray] = lambda q: q,
        refuses: Callable[[], bool] = lambda: False,
        ends_tacitly: Callable[[], bool] = lambda: False,
    ) -> None:
        super().__init__(arm, io, encoders=encoders, refuses=refuses, ends_tacitly=ends_tacitly)
        self.events: list[str] = []  # what the second connection is to hear, without its form; the server takes them
        self.hello = False
        self._session = session
        self._watchdog = Watchdog()
        self._beat = -np.inf
        self._demand: str | None = None
        self._ending: str | None = None  # why the motion is to end, PAUSE: it may be resumed
        self._paused = False
        self._planner: Planner | None = None  # of the motion that may be resumed
        self._target = Goals()
        self._contact: np.ndarray | None = None  # limits of the torques and the force of each motion, shape (8,)
        self._brake: Brake | None = None  # of a servo mode that is held
        self._held = ""
        self._followed = False  # whether servo mode ran in the last cycle
        self._tool_mass = self._load_mass = Mass()
        self._soft: Softness | None = None  # of the next servo modes
        self._softness: Softness | None = None  # of the present one
        self._own: dict[str, Callable[[Request], str]] = {
            "lrBeat": lambda _: words.ok("lrBeat"),
            "lrState": lambda _: self._state(),
            **{name: lambda request: self._demanded(request.name) for name in ("lrPause", "lrResume", "lrCancel")},
            "lrChannel": lambda request: words.no(request.name, "not on this connection"),
            "jpState": self._goal_state,
            "lrWatchdog": self._set_watchdog,
            "lrContact": self._set_contact,
            "lrTool": self._set_tool,
            "lrLoad": self._set_load,
            "lrSoftJoints": self._set_soft,
            "lrSoftTool": self._set_soft,
            "lrStiff": self._set_stiff,
            "lrFloat": self._float,
            "lrGuide": self._guide,
        }
        arm.state_load(self._tool_mass.in_metres, self._load_mass.in_metres)

    @property
    def phase(self) -> str:
        """What the main thread does: IDLE, MOTION, PAUSED, SERVO or HELD."""
        if self.mode == "ptp":
            return "PAUSED" if self._paused else "MOTION"
        return "IDLE" if self.mode == "idle" else "HELD" if self._brake is not None else "SERVO"

    @property
    def in_motion(self) -> bool:
        return super().in_motion or self._paused

    def gives_way(self, now: float) -> bool:
        """Returns whether the client has been silent for so long that the next one may come."""
        silent = now - self._beat
        return silent > (self._watchdog.end if self.hello else OLD_CLIENT_SILENT_S) and self.phase != "MOTION"

    def stop(self) -> str:
        """Stops whatever moves, for anybody; returns the answer."""
        self._demand, self._word = "STOP", ""
        if self._accepted is not None:
            self._ending = "the client"
        return words.ok("lrStop")

    def joins(self, request: Request) -> bool:
        """Returns whether a second connection names this client's session."""
        return self.hello and not self.ended and request.refusal is None and request.numbers[0] == self._session

    def second(self, line: str, now: float) -> str:
        """Returns the answer to a line of the second connection."""
        self._advance(now)
        request = words.read(line)
        if request.name == "lrStop":
            return self.stop()
        if request.name in ("lrPause", "lrResume", "lrCancel"):
            return self._demanded(request.name)
        return self._state() if request.name == "lrState" else words.no(request.name, "not on this connection")

    def receive(self, line: str, now: float) -> str:
        self._advance(now)
        if not self.ended and line:
            self._beat = now
            self._take(words.read(line))
            self._reader_alive = self._main_alive = True  # nothing that is malformed silences anybody
        return self._take_replies()

    def abandon(self) -> None:
        self._ending, self._paused = "the client is gone", False
        if self._serving:
            self._end_servo(self._ending)
        super().abandon()

    def _take(self, request: Request) -> None:
        self._word = request.line
        if request.name == "lrHello":
            if request.refusal is None:
                self.hello = True
                self._replies.append(f"ok_lrHello_leapRig_1_{self._session}_{ABILITIES}_\n")
        elif request.name == "lrStop":
            self._replies.append(self.stop())
        elif self.hello:
            no = "unknown" if request.word is None else self._refusal(request)
            if no is not None:
                self._replies.append(words.no(request.name, no))
            elif request.word is not None and request.word.ours:
                self._replies.append(self._own[request.name](request))
            else:
                self._answer(request.line)
        elif request.word is None or not request.word.ours:
            self._answer(request.line)

    def _refusal(self, request: Request) -> str | None:
        assert request.word is not None  # the caller answers what is none
        no = request.refusal
        goal = request.word.kind == words.GOAL or request.name == "jpState"
        if no is None and goal:
            joint = words.outside(request.numbers)
            if joint is not None:
                no = f"joint {joint + 1} is {java_text.text(request.numbers[joint])} rad, beyond its range"
        if no is None and goal and self._brake is not None:
            no = f"held: {self._held}"
        if no is None and request.word.kind == words.AT_REST and self.busy:
            no = "the arm is not at rest"
        return no

    def _demanded(self, name: str) -> str:
        modes = {"lrPause": ("MOTION", "SERVO"), "lrResume": ("PAUSED", "HELD"), "lrCancel": ("PAUSED",)}[name]
        if self.phase not in modes:
            return words.no(name, f"the mode is {self.phase}")
        if self._demand is not None:
            return words.no(name, "another demand is open")
        self._demand = name
        return words.ok(name)

    def _state(self) -> str:
        arm, longest_cycle_ms = self._arm, 1e3 * CYCLE_S
        joints, wrench = self._encoders(arm.q), (arm.tool_force, arm.tool_moment)
        numbers = np.concatenate([joints, arm.measured_torques, arm.external_torques, *wrench, [longest_cycle_ms]])
        return f"state_{self.phase}_{java_text.vector(numbers)}{OPERATION_MODE}_{self._enabling()}_{self._safety()}_\n"

    def _enabling(self) -> str:
        return "HANDGUIDING" if self._arm.enabling else "NONE"

    def _safety(self) -> str:
        return "NOSTOP" if self._arm.safety_stop is None else "STOP1"

    def _goal_state(self, request: Request) -> str:
        before = self._state()
        self._take_goal(lambda: "", [*map(java_text.text, request.numbers)])
        return before

    def _set_watchdog(self, request: Request) -> str:
        no = self._watchdog.set(*request.numbers)
        if no is not None:
            return words.no(request.name, no)
        return words.ok(request.name, (self._watchdog.brake, self._watchdog.end))

    def _set_contact(self, request: Request) -> str:
        no = words.refused_contact(request.numbers)
        if no is not None:
            return words.no(request.name, no)
        self._contact = np.array(request.numbers)
        return words.ok(request.name, request.numbers)

    def _set_tool(self, request: Request) -> str:
        n = request.numbers
        no = self._weigh(request, Mass(*n[:4]), self._load_mass)
        if no is None:
            self._arm.attach(pose_from_frame(np.array(n[4:])))
        return self._weighed(request, no)

    def _set_load(self, request: Request) -> str:
        return self._weighed(request, self._weigh(request, self._tool_mass, Mass(*request.numbers)))

    def _weigh(self, request: Request, tool: Mass, load: Mass) -> str | None:
        """Takes tool and load; returns why not, or None."""
        no, kg = words.refused_tool(request.numbers), tool.kg + load.kg
        if no is None and kg > words.MOST_KG:
            no = f"tool and load weigh {java_text.text(kg)} kg, more than {java_text.text(words.MOST_KG)}"
        if no is None:
            self._tool_mass, self._load_mass = tool, load
            self._arm.state_load(tool.in_metres, load.in_metres)
        return no

    def _weighed(self, request: Request, no: str | None) -> str:
        if no is not None:
            return words.no(request.name, no)
        tool, load = self._tool_mass, self._load_mass
        kg = tool.kg + load.kg
        centres = zip((tool.x, tool.y, tool.z), (load.x, load.y, load.z))
        both = [(tool.kg * one + load.kg * other) / kg if kg else 0.0 for one, other in centres]
        return words.ok(request.name, (kg, *both))

    def _set_soft(self, request: Request) -> str:
        kind = "JOINTS" if request.name == "lrSoftJoints" else "TOOL"
        no = words.refused_softness(request.numbers) or self._not_soft()
        if no is not None:
            return words.no(request.name, no)
        self._soft = Softness(kind, request.numbers)
        return words.ok(request.name, request.numbers)

    def _set_stiff(self, request: Request) -> str:
        self._soft = None
        return words.ok(request.name)

    def _not_soft(self) -> str | None:
        """Returns why the arm may not be soft, or None."""
        if not self._tool_mass.kg:
            return "the tool's mass is not known: say lrTool first"
        return None if self._arm.load_is_right else "the controller's load check fails: mass, centre or pose are wrong"

    def _float(self, request: Request) -> str:
        no = self._not_soft()
        if no is not None:
            return words.no(request.name, no)
        self._serve(Softness("FLOAT"))
        return words.ok(request.name)

    def _guide(self, request: Request) -> str:
        self._move(lambda arm, _: arm.start_guiding())
        self._break_when = None
        return words.ok(request.name)

    def _forget_tool(self) -> None:
        """Who said hello keeps its tool."""
        if not self.hello:
            super()._forget_tool()

    def _end(self, _: list[str]) -> str:
        self.abandon()
        self.ended = True
        return ""

    def _advance(self, now: float) -> None:
        arm = self._arm
        while self.busy and arm.time is not None and now - max(self._now, arm.time) > 1.5 * CYCLE_S:
            self._cycle(max(self._now, arm.time) + CYCLE_S)
        self._cycle(now)

    def _cycle(self, now: float) -> None:
        super()._advance(now)
        wanted, self._demand = self._demand, None
        why = self._halted(wanted)
        if self.mode == "ptp":
            self._cycle_motion(wanted, why)
        elif self.mode == "servo":
            self._cycle_servo(wanted, why)

    def _halted(self, wanted: str | None) -> str | None:
        """Returns why what moves must stop now, or None."""
        if wanted == "STOP":
            return "the client"
        if not self.hello:
            return None
        if self.mode == "ptp" and self._silence > self._watchdog.brake:
            return "the watchdog"
        return None if self._arm.safety_stop is None else f"a safety stop, {self._safety()}"

    @property
    def _silence(self) -> float:
        return self._now - self._beat

    def _move(self, make: Planner, break_when: Break | None = None, arrived: Condition = lambda _: True) -> str:
        self._ending, self._paused, self._planner = None, False, make
        self._target = dataclasses.replace(self._goals, joints=self._goals.joints.copy())
        contact = self._contact if self.hello else None
        return super()._move(make, broken_by_contact(break_when, contact), arrived)

    def _start_motion(self, make: Planner) -> None:
        self._arm.broken_by = ""

        def planned(arm: SimulatedArm, _: Goals) -> JointMove | None:
            if self._ending is not None:
                raise Unreachable(f"stopped by {self._ending}")
            return make(arm, self._target)

        super()._start_motion(planned)

    def _cycle_motion(self, wanted: str | None, why: str | None) -> None:
        if self._paused:
            self._cycle_paused(wanted, why)
        elif why is not None and not self._ending:
            self._ending, self._word = why, ""
            self._arm.break_motion(at_once=True)
        elif wanted == "lrPause" and self._ending is None and not self._refused:
            self._ending = PAUSE
            self._arm.break_motion(at_once=True)

    def _cycle_paused(self, wanted: str | None, why: str | None) -> None:
        if why is not None or wanted == "lrCancel":
            self._paused, self._ending = False, why or "a cancel"
        elif wanted == "lrResume":
            assert self._planner is not None  # a motion was paused
            self._paused, self._ending = False, None
            self._accepted, self._last_word = self._planner, self._now + LAST_WORD_S
            self._tell("the motion is resumed")

    def _finish_motion(self, now: float) -> None:
        broken = self._arm.broken_by
        if self._ending == PAUSE and not self._refused and not broken:
            self._paused = True
            self._tell("the motion is paused")
            return
        if self._ending:
            self._tell(f"the motion was stopped by {self._ending}")
        elif self._arm.gave_up:
            self._tell(f"the controller gave the motion up: {self._arm.gave_up}")
        elif broken:
            self._tell(f"contact: {broken}")
        self._keeps_word = self._keeps_word and not self.hello  # who said hello was told no, or is to ask again
        super()._finish_motion(now)

    def _result(self) -> str:
        if self._ending:
            return words.stopped(self._ending) if self.hello else NAK
        if self._arm.broken_by and self.hello and not self._refused:
            return words.stopped(f"contact, {self._arm.broken_by}")
        return NAK if self._arm.gave_up else super()._result()

    def _start_servo(self, _: list[str]) -> str:
        self._serve(self._soft)
        return DONE

    def _serve(self, softness: Softness | None) -> None:
        self._brake, self._followed, self._softness = None, True, softness
        super()._start_servo([])
        self._tell("servo mode begins" + (f", {softness.kind}" if softness else ""))

    def _begin_servo(self) -> None:
        super()._begin_servo()
        if self._softness is not None:
            self._arm.soften(self._softness)

    def _stop(self, _: list[str]) -> str:
        if self._serving:
            self._end_servo("the client's word")
        return DONE

    @property
    def _serving(self) -> bool:
        return self.mode == "servo" and (self._servo_starts is not None or self._arm.in_servo)

    def _end_servo(self, why: str) -> None:
        self._stop_servo()
        self._brake, self._followed = None, False
        self._tell(f"servo mode ends: {why}")

    def _cycle_servo(self, wanted: str | None, why: str | None) -> None:
        if not self._serving:
            if self._followed:
                self._end_servo(self._fault())
            return
        if why is not None or (self.hello and self._silence > self._watchdog.end):
            self._end_servo(why or "the watchdog")
        elif self._brake is None:
            silent = self.hello and self._silence > self._watchdog.brake
            if silent or wanted == "lrPause":
                self._hold("paused" if wanted == "lrPause" else "the client was silent")
        elif wanted == "lrResume" and not self._brake.resting:
            self._demand = wanted
        elif wanted == "lrResume":
            self._brake = self._arm.destination = None
            self._goals.joints = self._arm.goal = self._arm.q.copy()
            self._tell("servo mode continues")
        if self._brake is not None:
            self._brake.advance(CYCLE_S)
            self._arm.destination = self._brake.destination

    def _fault(self) -> str:
        """Returns why the servo mode has ended by itself."""
        if self._arm.gave_up:
            return "the controller gave up"
        joint = words.outside(self._arm.goal)
        assert joint is not None  # nothing else ends it
        goal = java_text.text(self._arm.goal[joint])
        return f"joint {joint + 1} is to go to {goal} rad, beyond its range"

    def _hold(self, why: str) -> None:
        if self._softness is not None and self._softness.kind == "FLOAT":
            self._end_servo("a pause" if why == "paused" else "the watchdog")
            return
        self._brake, self._held = Brake(self._arm.q, self._arm.v), why
        self._tell(f"the arm brakes and holds: {why}")

    def _tell(self, what: str) -> None:
        self.events.append(what)


def broken_by_contact(guard: Break | None, contact: np.ndarray | None) -> Break | None:
    """Returns the condition that says which limit of a contact, shape (8,), or else of a guard the arm exceeds; 0:
    there is none."""
    if contact is None or not contact.any():
        return guard
    limits = np.where(contact > 0.0, contact, np.inf)

    def condition(arm: SimulatedArm) -> str:
        beyond = np.abs(arm.external_torques) > limits[:7]
        if beyond.any():
            return f"joint {beyond.argmax() + 1}"
        if contact[7] > 0.0 and np.linalg.norm(arm.tool_force) > contact[7]:
            return "force"
        return guard(arm) if guard is not None else ""

    return condition
