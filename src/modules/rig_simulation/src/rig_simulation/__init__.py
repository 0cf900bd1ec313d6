"""The simulated rig: devices that speak the real wire protocols, the physical world they share, the operator who steers
them, their faults, and what a viewer sees of it all. Nothing outside tests and launch files imports it."""
