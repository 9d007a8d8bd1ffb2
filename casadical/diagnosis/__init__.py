"""Why is there still a gap between the model and the robot: where it lies, which effect, how far it shrinks."""
