"""What people see of the simulated world: shapes and contact forces for RViz, a viewer window, and films. Nothing here
changes the world."""
