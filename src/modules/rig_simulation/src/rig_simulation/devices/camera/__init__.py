"""The simulated RGB-D camera: colour and depth images of the simulated world with the lens, noise and gaps of an Xtion
Pro Live."""
