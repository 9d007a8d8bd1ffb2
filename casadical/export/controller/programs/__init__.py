"""Programs in a controller's language: targets are rewritten, every other byte stays."""
