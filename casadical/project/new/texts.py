"""The text of the files of a new problem folder, with comments that say what may be changed."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from casadical.core.transforms import frame, from_rpy
from casadical.measurements.columns import Source
from casadical.project.problem_file import as_toml
from casadical.robot.robot import Robot

# Text of robot.toml where neither a URDF nor a DH table is given: an example arm.
EXAMPLE_ROBOT = """\
# An example arm with six joints: change the numbers to those of yours. Every key: docs/robot-file.md.
# Units stand in the keys (_mm or _m, _deg or _rad); a wrong or missing one is refused with a message.
casadical = 1
name = "Example arm"
convention = "modified"            # rows: Rx(alpha) Tx(a) Rz(theta + q) Tz(d); "standard" is converted on reading
notes = ["Every number of this arm is made up."]

[base]                             # where the robot stands in the measuring frame
unknown = "pose"                   # identified; "none" where it is known

[tool]                             # the measured point (a reflector, say) in the last link's frame
xyz_mm = [40, 20, 120]
unknown = "position"

[gravity]
frame = "measuring"                # the instrument is levelled; "base": the robot stands upright
vector_m_per_s2 = [0, 0, -9.81]

[payload]                          # on the flange; leave it out if there is none
mass_kg = 8
com_mm = [10, 0, 60]

[[joint]]                          # one row a joint, from the base to the flange
d_mm = 400
limits_deg = [-160, 160]           # range of the reading
body = { mass_kg = 40, com_mm = [60, 0, -80] }   # mass and mass centre of the link that the joint moves

[[joint]]
alpha_deg = -90
a_mm = 180
limits_deg = [-150, -20]
compliant = true                   # its drive gives under load: the compliance is identified too (method SKCM)
body = { mass_kg = 28, com_mm = [300, 0, 90] }

[[joint]]                          # an axis parallel to the one before: Hayati's beta is put in by itself
a_mm = 600
theta_deg = -90                    # added to the reading: where the controller's zero is
limits_deg = [-60, 120]
compliant = true
body = { mass_kg = 18, com_mm = [60, 30, 0] }

[[joint]]
alpha_deg = -90
a_mm = 120
d_mm = 620
limits_deg = [-170, 170]
compliant = true
body = { mass_kg = 8, com_mm = [0, 0, -200] }

[[joint]]
alpha_deg = 90
limits_deg = [-115, 115]
compliant = true
body = { mass_kg = 5, com_mm = [0, -20, 0] }

[[joint]]
alpha_deg = -90
d_mm = 115
limits_deg = [-170, 170]
body = { mass_kg = 2, com_mm = [0, 0, -30] }
"""

# Beginning of robot.toml, before the [[joint]] tables, where a DH table is given; a format string.
ROBOT_HEAD = """\
# Made from {table}. Every key: docs/robot-file.md. Units stand in the keys (_mm or _m, _deg or _rad).
casadical = 1
name = "{name}"
convention = "{convention}"            # modified: Rx(alpha) Tx(a) Rz(theta + q) Tz(d); standard is converted

[base]                             # where the robot stands in the measuring frame
unknown = "pose"                   # identified; "none" where it is known

[tool]                             # the measured point (a reflector, say) in the last link's frame
xyz_mm = [0, 0, 0]                 # TO DO: roughly where it is
unknown = "position"

[gravity]                          # it matters where joints are compliant
frame = "measuring"                # the instrument is levelled; "base": the robot stands upright
vector_m_per_s2 = [0, 0, -9.81]

# [payload]                        # on the flange, if there is one
# mass_kg = 10
# com_mm = [0, 0, 50]

# Every [[joint]] may have limits_deg = [lower, upper]; without, -360 .. 360 deg (-10 .. 10 m) are taken.
"""


# Text of problem.toml of a new folder; a format string.
_PROBLEM_TEMPLATE = """\
# What is calibrated, from what. Every key: docs/problem-folder.md.
casadical = 1
title = "{title}"
{data}{mark}
robot = "{robot}"
methods = [{methods}]{why}
# loss = "linear"                  # default "auto": rows that nothing explains are left out, and named
{urdf}
[[measurements]]                   # several of these tables go into one fit
file = "{file}"
# datasheet_mm = 0.05              # largest error of a point that the instrument's data sheet states, at your distance
# sigma_mm = 0.02                  # in its place, if you know it: of one coordinate; else it is estimated from the fit
{columns}
[sets]                             # no pose is in two sets
{sets}
"""


@dataclass(frozen=True)
class Given:
    """What a table of measured poses holds.

    columns : source of each column, by casadical's name
    left_out : reason for each row of the file that is omitted
    tools : names of the measured points
    kind : kind of measurement
    turned : whether orientations of the tool were measured
    tilted : whether the measuring instrument was not levelled
    inverted : whether poses are inverted in the table
    camera : where the camera is that saw them, "in hand", "to base" or unknown
    lens : its intrinsics, as named by `corners.INTRINSICS`; empty without
    """

    columns: Mapping[str, Source] = field(default_factory=dict)
    left_out: Mapping[int, str] = field(default_factory=dict)
    tools: Sequence[str] = ()
    kind: str = ""
    turned: bool = False
    tilted: bool = False
    inverted: bool = False
    camera: str = ""
    lens: Mapping[str, float] = field(default_factory=dict)


def problem_text(
    robot: Robot,
    given: Given | None,
    *,
    links: tuple[str | None, str | None] | None,
    named_sets: bool,
    seed: int,
    poses: int,
    file: str,
) -> str:
    """Return the text of problem.toml.

    given : interpretation of the measured table; None where poses are simulated
    links : base and tip link of a URDF; None for a robot file
    named_sets : whether the table has a column `set`
    seed : seed of the split, and of simulated poses
    poses : number of simulated poses
    file : name of the table
    """
    title = robot.name.replace('"', "'").replace("\\", "/")
    mark = f"                 # poses.csv is MADE UP: {poses} poses of the model itself (seed {seed}); put yours there"
    share = "identify = 0.7                     # used in the fit\nreport = 0.3                       # held out\n"
    share += "refit = true                       # the robots that are written: once judged, fitted to all poses\n"
    compliant = any(j.compliance is not None for j in robot.joints)
    # The line of problem.toml on the origin of measured data.
    data_line = '# data = "real"                    # or "synthetic"; printed above every result'
    held = given or Given()
    lines = [f'kind = "{held.kind}"'] if held.kind else []
    if held.inverted or held.camera:
        inverted = f"inverted = {str(held.inverted).lower()}"
        lines.append(f"{inverted:35s}# whether the table has poses of the fixed frame in the tool")
    if held.camera:
        camera = f'camera = "{held.camera}"'
        lines.append(f'{camera:35s}# "in hand", with its target at rest; or "to base", with its target on the robot')
    if held.lens:
        fx, fy, cx, cy, *distortion = held.lens.values()
        lines.append(f"intrinsics = {{ fx = {fx}, fy = {fy}, cx = {cx}, cy = {cy}, distortion = {distortion} }}")
    if held.left_out:
        lines += ["leave_out = [                      # rows of the file"]
        lines += [f"    {row}, # {why}" for row, why in held.left_out.items()]
        lines += ["]"]
    if held.columns:
        lines += ["", "[measurements.columns]             # our name = the file's heading"]
        lines += [f"{ours} = {as_toml(source).as_string()}" for ours, source in held.columns.items()]
    else:
        lines.append('# columns = { x_mm = "X" }         # our name = the file\'s name, where headers differ')
    return _PROBLEM_TEMPLATE.format(
        title=title if given else f"{title}: SYNTHETIC poses, for a first run",
        data=data_line if given else 'data = "synthetic"',
        mark="" if given else mark,
        robot="robot.urdf" if links else "robot.toml",
        methods='"KM", "SKCM"',
        why=f"             # geometry; geometry and joint compliance{'' if compliant else ', where the data carry it'}",
        urdf=_urdf_lines(links, held) if links else "",
        file=file,
        columns="\n".join([*lines, ""]),
        sets='column = "set"                     # of poses.csv: names every pose\'s set'
        if named_sets
        else f"seed = {seed}\n{share}".rstrip(),
    )


def _urdf_lines(links: tuple[str | None, str | None], given: Given) -> str:
    """Return the table [urdf] of problem.toml as TOML text.

    links : base and tip link, None for the default
    """
    lines = ["", "[urdf]"]
    for key, link in zip(("base_link", "tip_link"), links, strict=True):
        default = f'# {key} = "..."             # default: the only one there is, or where a gripper begins'
        lines.append(f'{key} = "{link}"' if link else default)
    lines.append("# compliant = [2, 3]               # joints whose compliance is identified too")
    for name in given.tools if len(given.tools) > 1 else [""] if given.turned else ():
        lines += ["", "[[urdf.tool]]", *([f"name = {json.dumps(name, ensure_ascii=False)}"] if name else [])]
        lines.append("xyz_mm = [0, 0, 0]                 # TO DO: roughly where it is in the frame of the tip link")
        lines += ['unknown = "pose"                   # the table says how it is turned'] if given.turned else []
    return "\n".join([*lines, ""])


def readme_text(name: str, robot: str, file: str, data: str | None, urdf: str | None, dh: str | None) -> str:
    """Return the text of README.md: the origin of each file, and the commands to run next.

    name : of the folder; robot : of the robot; file : of the table of poses
    data, urdf, dh : names of the files that the folder was made from, None for an example
    """
    origin = f"from `{urdf}`" if urdf else f"from the DH table `{dh}`" if dh else "an example, every number made up"
    poses = (
        f"a copy of `{data}`"
        if data
        else "**synthetic**: made up by the model itself. Results say nothing about a real robot. Replace the table by "
        'your measurements and write `data = "real"` in `problem.toml`'
    )
    return f"""\
# {robot}

| file | what it is |
|---|---|
| `robot.{"urdf" if urdf else "toml"}` | the nominal robot, {origin} |
| `{file}` | joint readings and positions: {poses} |
| `problem.toml` | what is calibrated, from what |

Next:

    casadical check {name}
    casadical calibrate {name} --out results
"""


def with_measured(robot: str, given: Given) -> str:
    """Return a robot file's text, changed to the tools and the frame of gravity of a table.

    robot : text of the robot file; given : interpretation of the table
    """
    start, rest = robot.split("[tool]", 1)
    own, after = rest.split("\n\n", 1)
    own = own.replace('"position"', '"pose"') if given.turned else own
    tables = [f"[tool]{own}"]
    if len(given.tools) > 1:
        keys = own.split("\n", 1)[1]
        tables = [
            f"[[tool]]  # measured point {n}\nname = {json.dumps(n, ensure_ascii=False)}\n{keys}" for n in given.tools
        ]
    # The two statements on gravity between which `with_measured` chooses.
    gravity_in_measuring_frame = (
        'frame = "measuring"                # the instrument is levelled; "base": the robot stands upright'
    )
    gravity_in_base_frame = (
        'frame = "base"                     # the robot stands upright; "measuring": the instrument is levelled'
    )
    return start + "\n\n".join(
        [*tables, after.replace(gravity_in_measuring_frame, gravity_in_base_frame) if given.tilted else after]
    )


def with_masses(text: str, robot: Robot, standard: bool) -> str:
    """Return a robot file's text with the robot's estimated masses added, marked as estimates.

    text : of the file, without masses; robot : with them
    standard : whether the rows are of the standard DH convention
    """
    row_head = "\n[[joint]]\n"
    lines, following = [], [*robot.joints[1:], None]
    width = f"""\
[width.body]                       # one sigma of the estimates: each mass as a share, each coordinate of a mass centre
mass_share = {robot.body_width.mass_share:g}
com_mm = {1e3 * robot.body_width.com:g}
# compliant = true in a [[joint]]: its deflection under gravity is identified too, by the method SKCM
"""
    line = 'masses = "estimated"               # TO DO: where you know them, leave this line and [width.body] out\n'
    head, *rows = text.replace("\n[base]", f"{line}\n[base]", 1).split(row_head)
    for row, joint, after in zip(rows, robot.joints, following, strict=True):
        assert joint.body
        # A standard row ends behind the first half of the next modified one, Rx(alpha) Tx(a).
        tail = frame(from_rpy(np.array([after.alpha, 0, 0])), np.array([after.a, 0, 0])) if after else robot.tool.T
        centre = tail[:3, :3].T @ (joint.body.com - tail[:3, 3]) if standard else joint.body.com
        shown = ", ".join(f"{1e3 * c:.0f}" for c in centre + 0.0)
        body = f"body = {{ mass_kg = {joint.body.mass:g}, com_mm = [{shown}] }}   # ESTIMATE from the reach"
        lines.append(f"{row.strip()}\n{body}\n")
    return row_head.join([f"{head.rstrip()}\n\n{width}", *lines])
