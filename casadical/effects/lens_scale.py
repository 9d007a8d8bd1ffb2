"""The lens of a camera that measures poses is calibrated wrongly."""

from dataclasses import dataclass

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, setting
from casadical.effects.camera_faults import SIDES, CameraFault, columns, vector


@dataclass(frozen=True)
class LensScale(CameraFault):
    """side : where the camera is, fixed or carried by the flange"""

    side: str = setting("fixed", SIDES)

    name = "lens_scale"
    on_list = "standard"
    needs = (*columns("fixed", "depth"), *columns("fixed", "radial"))
    signature = "errors along the lens's axis that grow with the way, or away from it towards the image's edge"
    physics = (
        "A focal length that is wrong by a share makes all ways along the axis wrong by that share; a wrong radial "
        "distortion moves what is far from the axis by the third power of its slope (Brown 1971)."
    )
    confused_with = "tracker_scale, where all ways are about as long"
    size = {"depth": (5e-4, "m/m"), "radial": (5e-3, "m/m")}

    @property
    def conditions(self) -> tuple[str, ...]:
        return (*columns(self.side, "depth"), *columns(self.side, "radial"))

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        return point + sum(self.value(context, what) * vector(context, self.side, what) for what in self.size)
