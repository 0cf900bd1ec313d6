"""The whole rig: bring-up in `ros` (demo, leap_teleop), `operator` (view, sounds, tutorial), `report`, `recording`."""
