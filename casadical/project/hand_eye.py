"""The hand-eye transform of a calibration: where its camera is on the flange, or in the base frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from casadical.core.basics import Array
from casadical.core.reporting.plain import WRITTEN, Key, written
from casadical.core.reporting.result import Shown
from casadical.core.transforms import quaternion
from casadical.identification.result import Identification
from casadical.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class HandEye(Shown):
    """The camera's frame in that of the flange (eye in hand) or of the base (eye to base).

    camera : "in hand" or "to base"
    parent : frame in which it is given, flange or base; the flange is the last link's frame
    T : pose of the camera in it, shape (4, 4) [m]
    std_errors : of its coordinates [m], None where they were not identified
    nominal : whether the arm has its nominal geometry, else the calibrated one
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
    nominal: bool = False

    def in_words(self) -> str:
        """Return the camera's place as a sentence [mm]; the calibrated one names errors in it."""
        x, y, z = (f"{1e3 * v:.2f}" for v in self.T[:3, 3])
        sure = ""
        if self.std_errors is not None:
            sure = f" (+- {', '.join(f'{1e3 * s:.2g}' for s in self.std_errors)})"
        rows = {"flange": "last", "base": "first"}
        if self.nominal:
            return f"With the nominal arm: x {x}, y {y}, z {z} mm{sure}."
        return (
            f"Hand-eye (camera in the frame of the {self.parent}, eye {self.camera}): x {x}, y {y}, z {z} mm{sure}; "
            f"errors of the {rows[self.parent]} row are part of it."
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


def hand_eye_of(found: Identification, *, nominal: bool = False) -> HandEye | None:
    """Return the hand-eye transform of an identification, or None.

    None where no camera measured poses, or the pose of the base is not identified.

    nominal : whether it is for the nominal arm, with base and tool alone fitted
    """
    camera = next((m.camera for m in found.measurements if m.orientation is not None), "")
    if not camera or found.robot.base.unknown != "pose":
        return None
    # Its parent frame, and the placement whose parameters have the transform.
    parent, group = {"in hand": ("flange", "tool"), "to base": ("base", "base")}[camera]
    robot, names, C = found.placed_fit if nominal else (found.robot, found.names, found.covariance)

    def transform(robot: Robot) -> Array:
        return robot.tool.T if parent == "flange" else np.linalg.inv(robot.base.T)

    own = [k for k, name in enumerate(names) if name.startswith(f"{group}_")]
    T, step = transform(robot), 1e-6
    moved = (robot.with_values({names[k]: robot.parameters[names[k]].value + step}) for k in own)
    J = np.array([(transform(r)[:3, 3] - T[:3, 3]) / step for r in moved]).reshape(-1, 3)
    x, y, z = (float(v) for v in np.sqrt(np.maximum(np.diag(J.T @ C[np.ix_(own, own)] @ J), 0.0)))
    sure = len(own) == 6 and np.isfinite([x, y, z]).all()
    return HandEye(camera, parent, T, (x, y, z) if sure else None, nominal)
