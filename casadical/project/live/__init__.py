"""A calibration while it is measured: readings as they come, judged before the next pose, kept whatever happens."""

from casadical.project.live.session import LiveSession

__all__ = ["LiveSession"]
