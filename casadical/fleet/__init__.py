"""Many campaigns and many robots: what changed since last time, and what robots of one type share."""
