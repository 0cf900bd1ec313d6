"""The programs record.py, record_episodes.py, replay.py, export_recording.py and dataset_report.py."""
