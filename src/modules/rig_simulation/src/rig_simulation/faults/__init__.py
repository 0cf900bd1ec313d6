"""The faults of all simulated devices: what each does, when it is on, and its effect on the bytes of the wire. A device
owns one set of switches, which its control port operates."""
