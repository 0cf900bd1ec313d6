"""Rows 54 to 56: engaging."""

from __future__ import annotations

from campaign.judge import Limits
from campaign.trial import row

PLANNED = Limits(joint_speed=0.3, tool_speed=0.35)
"""A planned motion runs at a quarter of the full joint speeds, and the stream begins with a third of its own."""


@row(54, "Axis convention or scale file wrong", "R", within=3.0, named_by="axes are mirrored|millimetres", still=True,
     argued="axes-of-the-tracker.md", variant="tracker",
     dangerous="an arm that moves to the wrong side, or ten times as far")  # fmt: skip
def wrong_axes(trial):
    rig = trial.rig
    trial.check("control is on", rig.control(True).success)
    trial.fault("leap", "mirrored")
    rig.hand.show(right=0.02)
    trial.says("axes are mirrored", 10.0)
    rig.watch(2.0)
    for factor in (0.1, 25.4, 3.0):
        said = len(rig.said)
        rig.leap.ask("fault", name="scaled", value=factor)
        rig.leap.ask("fault", name="mirrored", on=False)
        rig.hand.show(right=0.02)
        rig.wait(lambda said=said: any("not millimetres" in text for _, _, text in rig.said[said:]), "the reason", 10.0)
        rig.watch(1.0)
    trial.check("no stream began", not rig.desired and {state for state, _ in rig.stream} == {"waiting"})
    trial.operator()
    rig.hand.hide()
    trial.mend("leap", "scaled")
    rig.bring_hand(right=0.02)
    rig.wait_for_modes("servo")
