"""Grids of settings that several effects share."""

import numpy as np

LAGS = (0.0, 300.0, 600.0, 1200.0, 2400.0)
TIMES = tuple(float(t) for t in np.linspace(0.03, 0.97, 32))
# For steps of several numbers each: they follow the data better between two times.
FEW_TIMES = tuple(float(t) for t in np.linspace(0.06, 0.94, 12))
