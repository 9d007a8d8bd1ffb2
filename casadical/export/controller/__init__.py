"""A calibrated robot and its controller: the correction as C, and joint targets of offline programs corrected."""
