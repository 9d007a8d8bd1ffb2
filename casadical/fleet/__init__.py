"""Changes of robots between campaigns, and what the robots of a fleet have in common."""
