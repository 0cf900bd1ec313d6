"""The simulated RGB-D camera: pictures of the simulated world as an Xtion Pro Live would take them."""
