"""casadical: robot calibration with known uncertainty.

Names are loaded when they are first used (`__init__.pyi` lists them), so that ``import casadical``
costs next to nothing and a stand-alone part (``casadical.compensator``, ``casadical.export``) never
loads the kinematics.
"""

from casadical.core.lazy import attach

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = attach(__name__, __file__)
