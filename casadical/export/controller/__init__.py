"""The correction of joint commands: its C export, and robot programs with corrected targets."""
