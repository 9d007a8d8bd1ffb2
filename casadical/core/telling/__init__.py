"""Blocks of words, tables and figures as data, and renderers that know nothing of what they show."""
