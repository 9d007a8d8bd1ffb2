"""What is known of a robot's drives: the table [drive] of a robot file. What is left out is unknown, and no default."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Discriminator, Field, Tag

from casadical.core.basics import Array, InputError
from casadical.core.reading import load_toml
from casadical.core.schema import FORMS, FaultError, Quantity, TomlTable, check

Least = Annotated[float, Field(ge=0)]
Above = Annotated[float, Field(gt=0)]
_ALL, _EACH = Tag(FORMS[2]), (Field(min_length=1), Tag(FORMS[3]))
_EITHER = Discriminator(lambda value: FORMS[2 + isinstance(value, list)])
# One number for all joints, or one of each; above zero; of either sign.
Each = Annotated[Annotated[Least, _ALL] | Annotated[list[Least], *_EACH], _EITHER] | None
Positive = Annotated[Annotated[Above, _ALL] | Annotated[list[Above], *_EACH], _EITHER] | None
EachSigned = Annotated[Annotated[float, _ALL] | Annotated[list[float], *_EACH], _EITHER] | None
_STIFFNESS = Quantity({"_Nm_per_rad": 1.0, "_N_per_m": 1.0}, 1e15)
_DAMPING = Quantity({"_Nms_per_rad": 1.0, "_Ns_per_m": 1.0}, 1e15)
_INTEGRAL = Quantity({"_Nm_per_rad_s": 1.0, "_N_per_m_s": 1.0}, 1e15)
_TORQUE = Quantity({"_Nm": 1.0, "_N": 1.0}, 1e9)
_CURRENT = Quantity({"_A": 1.0, "_mA": 1e-3}, 1e6)
_SPEED = Quantity({"_rad_s": 1.0, "_deg_s": np.pi / 180, "_m_s": 1.0, "_mm_s": 1e-3}, 1e5)
_CONSTANT = Quantity({"_Nm_per_A": 1.0, "_N_per_A": 1.0}, 1e6)
_INERTIA = Quantity({"_kgm2": 1.0, "_kg": 1.0}, 1e6)
_ANGLE = Quantity({"_rad": 1.0, "_deg": np.pi / 180, "_m": 1.0, "_mm": 1e-3}, 10.0)
_TIME = Quantity({"_s": 1.0, "_ms": 1e-3}, 10.0)
_HEIGHT = Quantity({"_m": 1.0, "_mm": 1e-3}, 1e4)


class Drive(TomlTable):
    """Drives of all joints, in SI, on the joint's side unless said otherwise; a number holds for every joint.

    kp, kd, ki : gains of the position servo; joint_stiffness : of the gear, between motor and joint
    friction : dry, damping : of all that grows with speed, bias : a constant torque, all three at the joint
    torque_limit : at the joint; current_limit : of the motor; speed_limit : of the joint
    gear_ratio : turns of the motor a turn of the joint; torque_constant, rotor_inertia : on the motor's side
    rotor_inertia_at_joint : times the ratio squared; encoder_quantum : as logged, at the joint
    encoder_side : on which the logged position is measured
    delay : from the logged command to the servo; command_filter : time constant; read_skew : from joint to joint
    servo, command_logged, temperature : in words (before or after limits and interpolation, and so on)
    floor : height of the tool's point on a surface below that it rests on, over the measuring frame's origin
    log_angles, log_effort : unit of angles, and what stands in the field effort, where a log does not say it
    """

    model_config = ConfigDict(frozen=True)

    servo: str = ""
    kp: Annotated[Each, _STIFFNESS] = None
    kd: Annotated[Each, _DAMPING] = None
    ki: Annotated[Each, _INTEGRAL] = None
    friction: Annotated[Each, _TORQUE] = None
    damping: Annotated[Each, _DAMPING] = None
    bias: Annotated[EachSigned, _TORQUE] = None
    torque_limit: Annotated[Each, _TORQUE] = None
    current_limit: Annotated[Each, _CURRENT] = None
    speed_limit: Annotated[Each, _SPEED] = None
    gear_ratio: Positive = None
    torque_constant: Annotated[Positive, _CONSTANT] = None
    rotor_inertia: Annotated[Each, _INERTIA] = None
    rotor_inertia_at_joint: Annotated[Each, _INERTIA] = None
    joint_stiffness: Annotated[Each, _STIFFNESS] = None
    encoder_side: Literal["motor", "joint"] | None = None
    encoder_quantum: Annotated[Each, _ANGLE] = None
    current_quantum: Annotated[Each, _CURRENT] = None
    command_logged: str = ""
    delay: Annotated[Each, _TIME] = None
    command_filter: Annotated[Each, _TIME] = None
    read_skew: Annotated[Each, _TIME] = None
    floor: Annotated[float | None, _HEIGHT] = None
    log_rate_Hz: Annotated[float, Field(gt=0)] | None = None
    log_angles: Literal["deg", "rad", "percent"] | None = None
    log_effort: Literal["torque", "current"] | None = None
    temperature: str = ""

    def of_joints(self, field: str, joints: int) -> Array | None:
        """A field joint by joint, shape (joints,) [SI]; None where it is unknown."""
        value = getattr(self, field)
        return None if value is None else np.broadcast_to(np.asarray(value, dtype=float), (joints,))

    def torque_per_ampere(self, joints: int) -> Array | None:
        """Torque at the joint a motor current of 1 A, shape (joints,) [N m or N]; None without constant and ratio."""
        ratio, constant = (self.of_joints(name, joints) for name in ("gear_ratio", "torque_constant"))
        return None if ratio is None or constant is None else ratio * constant

    def inertia_at_joint(self, joints: int) -> Array | None:
        """Rotor inertia as the joint feels it, shape (joints,) [kg m^2 or kg]; None where it is unknown."""
        fields = ("rotor_inertia_at_joint", "gear_ratio", "rotor_inertia")
        stated, ratio, rotor = (self.of_joints(name, joints) for name in fields)
        return stated if stated is not None or ratio is None or rotor is None else ratio**2 * rotor

    def refuse_other(self, joints: int) -> None:
        """Raises FaultError where a list has not one number for each joint."""
        for name, value in self:
            if isinstance(value, list) and len(value) != joints:
                wanted = f"allowed: one, or one for each of {joints} joints"
                raise FaultError(("drive", name), f"has {len(value)} numbers; {wanted}")

    def table(self) -> dict[str, object]:
        """As a file has it: what is known, by keys with units."""
        return {key: value for (_, value), key in zip(self, self.keys(), strict=True) if value not in (None, "")}


def read_drive(path: str | Path, joints: int) -> Drive:
    """The table [drive] of a TOML file beside a log. Raises InputError: no such table, or what is wrong in it."""
    path = Path(path)
    table = load_toml(path).get("drive")
    if not isinstance(table, dict):
        raise InputError(f"{path.name}: has no table [drive]; write what is known of the drives into one")
    drive = check(Drive, table, f"{path.name}, drive")
    try:
        drive.refuse_other(joints)
    except FaultError as error:
        raise InputError(f"{path.name}: {'.'.join(map(str, error.place))}: {error}") from None
    return drive
