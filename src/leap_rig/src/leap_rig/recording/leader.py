"""Who led the tool in a recording, by leap_kuka/state: a policy, an operator who intervenes, or neither.

An operator intervenes from the frame in which a hand takes the tool over from a policy until that hand is gone or
clutches. Before the policy led, and where none did, a hand only steers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from common.teleop_record import LED, RUNNING, TAKEN
from leap_rig.recording.recording_files import RecordingFault, between
from leap_rig.recording.run import MessageDecoders
from leap_rig.recording.signals import held

STATE = "/leap_kuka/state"
SILENT_S = 1.0  # it comes each 0.2 s; a node that is gone leads nothing


def read_leader(folder: Path, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns whether a policy led, and whether an operator intervened, shape (n,), at `times` since the epoch [s];
    raises RecordingFault for a message of another kind."""
    decode, received, states = MessageDecoders(), [], []
    for message in between(folder, [STATE], 0.0, float("inf")):
        try:
            fields = decode(message)
            states.append((str(fields["state"]), str(fields["hold"])))
        except (KeyError, ValueError) as error:
            raise RecordingFault(f"A message on {STATE} is not one of this rig: {error!r}.") from error
        received.append(1e-9 * message.received)
    rows, age = held(np.array(received), leader(states), times)
    fresh = age <= SILENT_S
    return (rows[:, 0] > 0.0) & fresh, (rows[:, 1] > 0.0) & fresh


def leader(states: Sequence[tuple[str, str]]) -> np.ndarray:
    """Returns for each state of the teleoperation, with its `hold`, whether a policy leads, and whether an operator
    intervenes; shape (n, 2)."""
    policy = np.array([hold == LED for _, hold in states], bool)
    hand = np.array([state == RUNNING for state, _ in states], bool)
    taken = np.array([hold == TAKEN for _, hold in states], bool) & policy.any()  # else from a hold that asked for it
    return np.column_stack([policy, hand & (np.logical_or.accumulate(policy) | taken)]).reshape(-1, 2)
