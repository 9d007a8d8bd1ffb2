"""Properties of a robot's drives, the table [drive] of a robot file.

An omitted value is unknown.
"""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Discriminator, Field, Tag

from casadical.core.basics import Array, InputError
from casadical.core.reading import load_toml
from casadical.core.schema import VALUE_FORMS, FaultError, Quantity, TomlTable, check

# Type of a number that is zero or more.
NonNegative = Annotated[float, Field(ge=0)]
# Type of a number above zero.
AboveZero = Annotated[float, Field(gt=0)]
# Pydantic annotation of a field that is one number for all joints.
_ONE_NUMBER = Tag(VALUE_FORMS[2])
# Pydantic annotations of a field that is a list with a number for each joint.
_LIST_OF_NUMBERS = (Field(min_length=1), Tag(VALUE_FORMS[3]))
# Pydantic discriminator between both forms of a field.
_NUMBER_OR_LIST = Discriminator(lambda value: VALUE_FORMS[2 + isinstance(value, list)])
# Type of one number for all joints or a list with one for each, zero or more; None: unknown.
Each = (
    Annotated[Annotated[NonNegative, _ONE_NUMBER] | Annotated[list[NonNegative], *_LIST_OF_NUMBERS], _NUMBER_OR_LIST]
    | None
)
# Type of one number for all joints or a list with one for each, above zero; None: unknown.
Positive = (
    Annotated[Annotated[AboveZero, _ONE_NUMBER] | Annotated[list[AboveZero], *_LIST_OF_NUMBERS], _NUMBER_OR_LIST] | None
)
# Type of one number for all joints or a list with one for each, of either sign; None: unknown.
EachSigned = (
    Annotated[Annotated[float, _ONE_NUMBER] | Annotated[list[float], *_LIST_OF_NUMBERS], _NUMBER_OR_LIST] | None
)
# Stiffness or position gain: unit suffixes of its keys in a robot file with their factors to SI,
# and its largest value [SI].
_STIFFNESS = Quantity({"_Nm_per_rad": 1.0, "_N_per_m": 1.0}, 1e15)
# Damping or velocity gain: unit suffixes of its keys, and its largest value [SI].
_DAMPING = Quantity({"_Nms_per_rad": 1.0, "_Ns_per_m": 1.0}, 1e15)
# Torque or force: unit suffixes of its keys, and its largest absolute value [SI].
_TORQUE = Quantity({"_Nm": 1.0, "_N": 1.0}, 1e9)
# Motor current: unit suffixes of its keys, and its largest value [A].
_CURRENT = Quantity({"_A": 1.0, "_mA": 1e-3}, 1e6)
# Joint speed: unit suffixes of its keys, and its largest value [SI].
_SPEED = Quantity({"_rad_s": 1.0, "_deg_s": np.pi / 180, "_m_s": 1.0, "_mm_s": 1e-3}, 1e5)
# Rotor inertia: unit suffixes of its keys, and its largest value [SI].
_INERTIA = Quantity({"_kgm2": 1.0, "_kg": 1.0}, 1e6)
# Resolution of a joint reading, or a stop: unit suffixes of its keys, largest absolute value [SI].
_ANGLE = Quantity({"_rad": 1.0, "_deg": np.pi / 180, "_m": 1.0, "_mm": 1e-3}, 10.0)
# Time: unit suffixes of its keys, and its largest value [s].
_TIME = Quantity({"_s": 1.0, "_ms": 1e-3}, 10.0)


class Drive(TomlTable):
    """Drives of all joints in SI units; a single number holds for every joint, None is unknown.

    Torques and inertias are those at the joint unless said otherwise; units are those of revolute
    joints, with N, m and kg in place of N m, rad and kg m^2 for prismatic ones.
    servo : description of the servo, as text
    kp, kd, ki : gains of the position servo [N m/rad, N m s/rad, N m/(rad s)]
    friction : dry friction torque [N m]
    damping : viscous friction and all else that grows with speed [N m s/rad]
    bias : constant torque [N m]
    torque_limit : largest torque at the joint [N m]; current_limit : largest motor current [A]
    speed_limit : largest speed of the joint [rad/s]
    gear_ratio : motor revolutions per revolution of the joint
    torque_constant : torque per current, on the motor's side [N m/A]
    rotor_inertia : inertia of the rotor, on the motor's side [kg m^2]
    rotor_inertia_at_joint : rotor inertia times the gear ratio squared [kg m^2]
    joint_stiffness : stiffness of the gear, between motor and joint [N m/rad]
    encoder_side : the side of the gear on which the logged position is measured
    encoder_quantum : resolution of the logged position, at the joint [rad]
    current_quantum : resolution of the logged current [A]
    command_logged : description of the logged command (before or after limits, interpolation and so
        on)
    delay : time from the logged command to the servo [s]
    command_filter : time constant of the filter of commands [s]
    read_skew : time between the readings of one joint and the next [s]
    floor : height of the tool point when the arm rests on the surface below, over the origin of the
        measuring frame [m]
    lower_stop, upper_stop : angles beyond which no joint comes [rad]
    log_rate_Hz : sampling rate of logs [Hz]
    log_angles, log_effort : unit of angles, and meaning of the field effort, where a log does not
        say it
    temperature : description of the temperatures, as text
    """

    model_config = ConfigDict(frozen=True)

    servo: str = ""
    kp: Annotated[Each, _STIFFNESS] = None
    kd: Annotated[Each, _DAMPING] = None
    ki: Annotated[Each, Quantity({"_Nm_per_rad_s": 1.0, "_N_per_m_s": 1.0}, 1e15)] = None
    friction: Annotated[Each, _TORQUE] = None
    damping: Annotated[Each, _DAMPING] = None
    bias: Annotated[EachSigned, _TORQUE] = None
    torque_limit: Annotated[Each, _TORQUE] = None
    current_limit: Annotated[Each, _CURRENT] = None
    speed_limit: Annotated[Each, _SPEED] = None
    gear_ratio: Positive = None
    torque_constant: Annotated[Positive, Quantity({"_Nm_per_A": 1.0, "_N_per_A": 1.0}, 1e6)] = None
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
    floor: Annotated[float | None, Quantity({"_m": 1.0, "_mm": 1e-3}, 1e4)] = None
    lower_stop: Annotated[EachSigned, _ANGLE] = None
    upper_stop: Annotated[EachSigned, _ANGLE] = None
    log_rate_Hz: Annotated[float, Field(gt=0, le=1e6)] | None = None
    log_angles: Literal["deg", "rad", "percent"] | None = None
    log_effort: Literal["torque", "current"] | None = None
    temperature: str = ""

    def of_joints(self, field: str, joints: int) -> Array | None:
        """Return a field with a number for each joint, shape (joints,) [SI]; None if it is unknown.

        field : name of the field, such as "kp"; joints : number of joints
        """
        value = getattr(self, field)
        return None if value is None else np.broadcast_to(np.asarray(value, dtype=float), (joints,))

    def torque_per_ampere(self, joints: int) -> Array | None:
        """Return joint torque over motor current, shape (joints,) [N m/A or N/A]; None if unknown.

        It is the gear ratio times the motor's torque constant.
        """
        ratio, constant = (self.of_joints(name, joints) for name in ("gear_ratio", "torque_constant"))
        return None if ratio is None or constant is None else ratio * constant

    def inertia_at_joint(self, joints: int) -> Array | None:
        """Return the rotor inertia at the joint, shape (joints,) [kg m^2 or kg]; None if unknown.

        It is the declared one, else the gear ratio squared times that of the rotor.
        """
        fields = ("rotor_inertia_at_joint", "gear_ratio", "rotor_inertia")
        stated, ratio, rotor = (self.of_joints(name, joints) for name in fields)
        return stated if stated is not None or ratio is None or rotor is None else ratio**2 * rotor

    def refuse_other(self, joints: int) -> None:
        """Check that every list has one number for each joint. Raises FaultError."""
        for name, value in self:
            if isinstance(value, list) and len(value) != joints:
                wanted = f"allowed: one, or one for each of {joints} joints"
                raise FaultError(("drive", name), f"has {len(value)} numbers; {wanted}")

    def table(self) -> dict[str, object]:
        """Return the declared values [SI] by TOML key, which ends in the first, SI unit."""
        return {key: value for (_, value), key in zip(self, self.keys(), strict=True) if value not in (None, "")}


def read_drive(path: str | Path, joints: int) -> Drive:
    """Return the drives in the table [drive] of a TOML file, for a robot of so many joints.

    Raises InputError: there is no such table, or a fault in it.
    """
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
