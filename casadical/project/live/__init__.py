"""Live calibration: readings are stored and judged as they come, and the next pose is named."""

from casadical.project.live.session import LiveSession

__all__ = ["LiveSession"]
