"""Changes of robots between campaigns, and all robots of a fleet."""
