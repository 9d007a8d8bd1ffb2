"""The hand-eye transform of a calibration: where its camera is on the flange, or in the base frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from casadical.core.basics import Array
from casadical.core.telling.plain import WRITTEN, Key, written
from casadical.core.telling.result import Shown
from casadical.core.transforms import quaternion
from casadical.identification.result import Identification

# Where the camera is -> its parent frame, and the placement whose parameters have the transform.
_PARENTS = {"in hand": ("flange", "tool"), "to base": ("base", "base")}


@dataclass(frozen=True, eq=False)
class HandEye(Shown):
    """The camera's frame in that of the flange (eye in hand) or of the base (eye to base).

    camera : "in hand" or "to base"
    parent : frame in which it is given, flange or base; the flange is the last link's frame
    T : pose of the camera in it, shape (4, 4) [m]
    std_errors : of its coordinates [m], None where they were not identified
    """

    line: ClassVar[str] = " {{ it.in_words() }}"
    derived: ClassVar[tuple[Key, ...]] = (
        Key("xyz", lambda it: it.T[:3, 3], unit="mm"),
        Key("quaternion_wxyz", lambda it: quaternion(it.T[:3, :3])),
    )

    camera: str = field(metadata=WRITTEN)
    parent: str = field(metadata=WRITTEN)
    T: Array
    std_errors: tuple[float, float, float] | None = field(metadata=written("std_error", unit="mm"))

    def in_words(self) -> str:
        """Return the transform as a sentence [mm, quaternion], with the errors that it includes."""
        x, y, z = (f"{1e3 * v:.2f}" for v in self.T[:3, 3])
        w, *vector = (f"{v:.5f}" for v in quaternion(self.T[:3, :3]))
        sure = ""
        if self.std_errors is not None:
            sure = f" (+- {', '.join(f'{1e3 * s:.2g}' for s in self.std_errors)})"
        rows = {"flange": "last", "base": "first"}
        return (
            f"Hand-eye (camera in the frame of the {self.parent}, eye {self.camera}): x {x}, y {y}, z {z} mm{sure}, "
            f"quaternion w {w}, xyz {', '.join(vector)}; errors of the {rows[self.parent]} row are part of it."
        )

    def calib_text(self, name: str) -> str:
        """Return the text of a calibration file of easy_handeye2, in metres and a quaternion.

        A comment has the command of ROS 2 for the same transform; name : of the calibration
        """
        x, y, z = (float(v) for v in self.T[:3, 3])
        w, i, j, k = (float(v) for v in quaternion(self.T[:3, :3]))
        kind = "eye_in_hand" if self.camera == "in hand" else "eye_on_base"
        place = f"--x {x:.9g} --y {y:.9g} --z {z:.9g} --qx {i:.9g} --qy {j:.9g} --qz {k:.9g} --qw {w:.9g}"
        return (
            f"# {self.in_words()}\n"
            f"# ros2 run tf2_ros static_transform_publisher {place} "
            f"--frame-id {self.parent} --child-frame-id camera\n"
            f"parameters:\n  name: {name}\n  calibration_type: {kind}\n  robot_base_frame: base\n"
            "  robot_effector_frame: flange\n  tracking_base_frame: camera\n  tracking_marker_frame: target\n"
            "  freehand_robot_movement: true\n  move_group_namespace: /\n  move_group: manipulator\n"
            f"transform:\n  translation:\n    x: {x:.9g}\n    y: {y:.9g}\n    z: {z:.9g}\n"
            f"  rotation:\n    x: {i:.9g}\n    y: {j:.9g}\n    z: {k:.9g}\n    w: {w:.9g}\n"
        )


def hand_eye_of(found: Identification) -> HandEye | None:
    """Return the hand-eye transform of an identification, or None.

    None where no camera measured poses, or the base was known.
    """
    camera = next((m.camera for m in found.measurements if m.orientation is not None), "")
    if not camera or found.robot.base.unknown != "pose":
        return None
    parent, group = _PARENTS[camera]
    T = found.robot.tool.T if parent == "flange" else np.linalg.inv(found.robot.base.T)
    errors = found.parameters.set_index("name")["std_error"].reindex([f"{group}_{c}" for c in "xyz"]).to_numpy()
    x, y, z = (1e-3 * float(error) for error in errors)
    return HandEye(camera, parent, T, (x, y, z) if np.isfinite([x, y, z]).all() else None)
