"""A small network that learns what calibration leaves. Stands alone: it loads no kinematics."""

from casadical.compensator.iwo import InvasiveWeeds, IwoHistory, IwoResult, IwoSettings, iwo_minimise
from casadical.compensator.layout import Box, Layout
from casadical.compensator.network import Network

__all__ = ["Box", "InvasiveWeeds", "IwoHistory", "IwoResult", "IwoSettings", "Layout", "Network", "iwo_minimise"]
