"""What the simulated person does with the rig, step by step, by what can be seen."""
