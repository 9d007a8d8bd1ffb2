"""Search for laws: symbolic expressions of residual errors, at one place of the robot each."""
