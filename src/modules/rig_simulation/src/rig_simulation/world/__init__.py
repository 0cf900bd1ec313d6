"""The physical world in MuJoCo: table, objects, arm and hand in one model, stepped in real time. The simulated
controller and the simulated hand act on it, and the camera renders it."""
