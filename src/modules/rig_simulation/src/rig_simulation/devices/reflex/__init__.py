"""The simulated ReFlex TakkTile hand: servos, fingers and taxels behind the hand's UDP packets. Its mechanics are
replaced by those of the simulated world when there is one."""
