"""From the hand over the Leap Motion to the desired tool frame of the arm."""
