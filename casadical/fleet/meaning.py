"""What each kind of change means, with its likely cause."""

from casadical.fleet.candidates import ROBOT, Course

MEANT: dict[Course, dict[str, str]] = {
    "jump": {
        "joint_zero": "the zero of joint {joint} is another: a crash, a slipped belt or a lost reference",
        "joint_stiffness": "joint {joint} bends by another amount under load: a belt or screws that came loose or were "
        "tightened, or damage of the gear",
        "joint_curve": "the error curve of joint {joint} over its own angle is another: damage of the gear, or its "
        "encoder was mounted again",
        "gear": "zero, stiffness and error curve of joint {joint} changed together: another gear",
        "link": "the geometry before joint {joint} is another: a bent link or a screw joint that slipped",
        "loop": "bars of four-bar {joint} have other lengths: a crash, or a bar was replaced",
        "lengths": "all lengths grew or shrank by one share: another temperature, or another scale of the instrument",
        "tool": "the measured point on the flange is elsewhere: another tool, or the same one mounted again",
        "foot": "the robot's foot moved in the measuring frame: a crash, or the robot was mounted again",
        "effect": "{label} has other values",
        ROBOT: "this looks like another robot than before: its parameters of all kinds differ, by as much as robots of "
        "one type do; look at the serial numbers and at the names of the tables",
    },
    "drift": {
        "joint_zero": "the zero of joint {joint} moves little by little: a belt that stretches, wear of the gear, or "
        "an encoder or a fastening that works loose",
        "joint_stiffness": "joint {joint} bends by another amount under load, little by little: a belt or screws that "
        "loosen, or wear of the gear",
        "joint_curve": "the error curve of joint {joint} over its own angle changes little by little: wear of the gear",
        "lengths": "all lengths grow or shrink by one share: a temperature or a scale of the instrument that drifts",
        "foot": "the robot's foot creeps in the measuring frame: ground that settles, or anchors that loosen",
    },
    "season": {"lengths": "all lengths grow and shrink by one share over the year: the temperature of the hall"},
    "once": {
        ROBOT: "this looks like another robot than before and after: its parameters of all kinds differ, by as much as "
        "robots of one type do; look at its serial number and at the name of the table",
    },
}
