"""What the operator sees and hears: `view` (rows out of the newest messages), `cues` (sounds), `tutorial`."""
