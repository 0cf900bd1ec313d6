"""The programs record.py, replay.py and export_recording.py."""
