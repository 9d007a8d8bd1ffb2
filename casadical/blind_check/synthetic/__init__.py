"""What both physics share and none of it is physics of an effect: a robot as built, the circumstances of its poses,
and the table of a campaign.

It uses numpy and pandas, and of casadical the errors alone: rotations, loops and arrays have their own code here, so
that a diagnosis checked against these campaigns is not checked against its own formulas.
"""
