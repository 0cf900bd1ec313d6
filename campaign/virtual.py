"""A row in virtual time, on a rig of its own. A seed makes one run, to the last bit."""

from __future__ import annotations

from pathlib import Path

from campaign import trial
from campaign.judge import Verdict
from campaign.trial import Row
from simulated.graph import Graph
from simulated.rig import VirtualRig


def judged(entry: Row, seed: int = 0, traces: Path | None = None) -> Verdict:
    """Runs a row and returns its verdict; stores what was seen in the folder `traces`."""
    with Graph(seed) as graph, VirtualRig(graph, entry.variant) as rig:
        rig.calm()
        return trial.run(rig, entry, traces)
