"""What every package may use: errors, frames, files, parameters, a robot's structure as plain data.

It imports none of the other packages.
"""
