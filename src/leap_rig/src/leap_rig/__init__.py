"""The whole rig: bring-up, demo and the report of what a run did."""
