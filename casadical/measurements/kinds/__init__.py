"""Kinds of measurement, one a file: columns, checks, residual and error; `registry` lists them."""
