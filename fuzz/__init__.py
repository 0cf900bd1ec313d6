"""Fuzzing: every parser and border of the rig takes input that nobody meant; see docs/handbook/endurance.md."""
