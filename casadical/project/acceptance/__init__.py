"""Whether a calibrated robot is as accurate as it must be: checks with later poses, ISO 9283, certificate data."""
