"""The nodes of the simulation: the camera, the operator, the fault service, and monitors of the world's truth. They
reach the simulated devices through control ports."""
