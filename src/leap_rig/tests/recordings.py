"""Recordings for tests, written as record.py writes them."""

import io

from leap_rig.recording.recording_files import PARAMETERS, MessageKind, RecordingWriter, StoredMessage

START = 1_700_000_000 * 10**9  # [ns]


def stored(topic, message, seconds, is_latched=False):
    """Returns a message of ROS as it is stored, received so many seconds after START."""
    buffer = io.BytesIO()
    message.serialize(buffer)
    kind = MessageKind(message._type, message._full_text, message._md5sum, is_latched)
    return StoredMessage(topic, kind, START + round(1e9 * seconds), buffer.getvalue())


def write_recording(folder, messages, parameters=b"{}", **about):
    """Writes a completed recording of stored messages."""
    writer = RecordingWriter(folder, about, {PARAMETERS: parameters}, START, 4096)
    for message in messages:
        writer.add(message)
    writer.close(START, "the test", {})
    return folder
