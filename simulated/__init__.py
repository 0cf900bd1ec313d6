"""The rig in one process and in virtual time: what a busy machine cannot change."""
