"""The simulated devices, one folder each. Every device serves the bytes of its real counterpart on loopback, so that
the rig's own drivers cannot tell the difference."""
