"""Measured poses: tables in, one immutable checked object in SI out."""
