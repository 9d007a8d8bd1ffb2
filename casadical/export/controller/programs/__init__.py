"""Programs in a controller's own language: their targets are read and rewritten, every other byte stays."""
