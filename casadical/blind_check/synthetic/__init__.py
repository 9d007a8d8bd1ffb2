"""What the two physics have in common: a robot as built, the circumstances of its poses, the table of a campaign.

Of casadical only the errors are imported. Rotations, loops and arrays are written again here, so that a diagnosis
checked against these campaigns is not checked against its own formulas.
"""
