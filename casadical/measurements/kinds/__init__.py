"""Kinds of measurement, one or more a file: columns, checks, residual and error; see `registry`."""
