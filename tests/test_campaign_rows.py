"""The rows of the campaign: in virtual time with their exact times, and on the real rig.

In virtual time a row takes a few seconds of a processor. The most dangerous ones run in `make test`, all others and all
rows on the real rig before a release.
"""

from __future__ import annotations

import itertools
import json
import re

import pytest

pytest.importorskip("rig_msgs.srv")
from campaign import rows, run, trial
from campaign.rig import RigUnderTest
from campaign.virtual import judged
from common.modes import TO_DESIRED_TOOL
from leap_rig.recording.ros import record_program
from simulated.graph import Graph
from simulated.rig import VirtualRig

pytestmark = pytest.mark.ros
ENTRIES = rows.load()
VIRTUAL = [entry for entry in ENTRIES.values() if not entry.real]
DANGEROUS = [entry for entry in VIRTUAL if entry.dangerous]
TIMES = json.loads(run.TIMES.read_text())
SPREAD_S, TOLD_S = 0.06, 0.12
"""How much a time depends on the order of threads and the delays of messages: cycles, or the period of a reason."""
SEEDS = range(1, 20)


def ids(entries, marks=lambda entry: ()):
    return [pytest.param(entry, id=str(entry.number), marks=marks(entry)) for entry in entries]


def expected_time(entry):
    time = TIMES[str(entry.number)]
    spread = TOLD_S if "R" in entry.expected.reactions else SPREAD_S
    return None if time is None else pytest.approx(time, abs=spread)


@pytest.mark.parametrize("entry", ids(VIRTUAL, lambda entry: () if entry.dangerous else pytest.mark.long))
def test_in_virtual_time(entry, monkeypatch):
    monkeypatch.setattr(record_program, "_commit", lambda _: "")  # which starts git
    found = judged(entry)
    assert found.faults == []
    assert found.reaction_s == expected_time(entry)


@pytest.mark.long
@pytest.mark.parametrize("entry", ids(DANGEROUS))
@pytest.mark.parametrize("seed", SEEDS)
def test_in_other_orders_and_with_other_delays(entry, seed):
    found = judged(entry, seed)
    assert found.faults == []
    assert found.reaction_s == expected_time(entry)


def test_a_seed_makes_one_run():
    def seen(seed):
        with Graph(seed, trace=True) as graph, VirtualRig(graph) as rig:
            rig.calm()
            trial.run(rig, ENTRIES[45])
            return list(graph.scheduler.trace), list(rig.arm.steps), [text for _, _, text in rig.said]

    (turns, steps, said), again, other = seen(1), seen(1), seen(2)
    assert steps == again[1] and said == again[2] and turns == again[0]
    assert turns != other[0] and steps != other[1]


@pytest.fixture(scope="module")
def kept_rig(tmp_path_factory):
    kept = run.KeptRig(tmp_path_factory.mktemp("traces"))
    yield kept
    kept.close()


@pytest.mark.long
@pytest.mark.parametrize("entry", ids(sorted(ENTRIES.values(), key=lambda entry: (entry.variant, entry.spoils))))
def test_on_the_real_rig_it_goes_as_in_virtual_time(kept_rig, entry, tmp_path):
    assert kept_rig.judge(entry)["faults"] == []
    if not entry.real:
        judged(entry, traces=tmp_path)
        assert modes(kept_rig.traces, entry) == modes(tmp_path, entry)


def modes(folder, entry):
    """Returns the modes of the controller since the fault, in their order."""
    seen = json.loads((folder / f"row_{entry.number}.json").read_text())
    return [mode for mode, _ in itertools.groupby(mode for when, mode in seen["entered"] if when >= seen["fault"])]


@pytest.mark.real
class TestRealRig:
    """Two rows by the real clock. A pause of the machine may end a stream or a link, too, and latch the arm. What is
    asserted is what no pause changes: the arm leaves the hand, and only an operator brings it back.
    """

    @pytest.fixture(scope="class")
    def whole_rig(self, ros_master, tmp_path_factory, pytestconfig):
        shared = pytestconfig.pluginmanager.get_plugin(str(pytestconfig.rootpath / "conftest.py"))
        rig = RigUnderTest(shared, tmp_path_factory.mktemp("rig"))
        try:
            rig.bring_up()
            yield rig
        finally:
            rig.end()

    @pytest.fixture
    def rig(self, whole_rig):
        """The rig behind an operator's hand, and what its nodes are."""
        whole_rig.calm()
        operate(whole_rig, lambda: whole_rig.mode == "servo", "servo mode")
        before = whole_rig.pids()
        del whole_rig.modes[:-1], whole_rig.said[:]
        yield whole_rig
        assert {name: pid for name, pid in before.items() if not whole_rig.runs(pid)} == {}

    def test_an_arm_that_is_lost_is_latched_until_the_operator_acts(self, rig):
        rig.arm.ask("fault", name="cut", duration=1.5)
        rig.wait(lambda: "stopped" in rig.modes, "the latch", 60.0)
        rig.wait(lambda: says(rig, "link to the controller broke|out of reach|not answer"), "the reason", 60.0)
        rig.wait(lambda: says(rig, "connected again|answers again"), "the connection", 60.0)
        rig.watch(1.0)
        assert rig.modes[-1] == "stopped" and not rig.status.control_on
        operate(rig, lambda: rig.mode == "servo", "the arm that follows again")

    def test_an_arm_whose_hand_is_lost_goes_home_and_follows_no_hand_that_is_there_again(self, rig):
        rig.leap.ask("fault", name="hand_lost", duration=2.0)
        rig.wait(lambda: rig.mode in ("home", "stopped"), "the arm at home, or latched by a pause", 60.0)
        lost = "was lost|no tracking frames come in|No new desired tool frame|out of reach|not answer"
        rig.wait(lambda: says(rig, lost), "the reason", 60.0)
        rig.watch(4.0)
        left = next(i for i, mode in enumerate(rig.modes) if mode not in TO_DESIRED_TOOL)
        assert not set(rig.modes[left:]) & set(TO_DESIRED_TOOL)
        operate(rig, lambda: rig.mode == "servo", "the arm that follows again")


def says(rig, text):
    return any(re.search(text, said) for _, _, said in list(rig.said))


def operate(rig, condition, what):
    """Plays an operator until a condition is true: switches control on where it is off, brings a hand in where none is
    followed.
    """

    def acts():
        if condition():
            return True
        if not rig.status.control_on:
            rig.hand.hide()
            rig.control(True)
        elif rig.stream_state != "running" and rig.hand.still:
            rig.hand.show(right=-0.06)
        return False

    rig.wait(acts, what, 60.0)
