"""The search for a law of what is left: at which place of the robot, by what, in which form."""
