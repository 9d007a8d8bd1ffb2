"""casadical: robot calibration with known uncertainty.

Names are loaded when they are first used (`__init__.pyi` lists them), so that ``import casadical`` costs next to
nothing and a stand-alone part (``casadical.compensator``, ``casadical.export``) never loads the kinematics.
"""

from casadical.core.lazy import attach

_find, __dir__, __all__ = attach(__name__, __file__)


def __getattr__(name: str) -> object:
    if name != "__version__":
        return _find(name)
    from casadical.core.version import installed

    return installed()
