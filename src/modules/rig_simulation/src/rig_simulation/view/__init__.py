"""What people see of the simulated world: shapes and forces for RViz, a window, films."""
