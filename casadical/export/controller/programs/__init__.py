"""Robot programs in controllers' languages: targets are rewritten, every other byte stays."""
