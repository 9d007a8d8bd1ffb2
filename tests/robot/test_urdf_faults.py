"""Every URDF that cannot be used is refused with a message that says what and where."""

import sys

import pytest
from urdf_arms import joint, link, robot

from casadical.core.basics import InputError
from casadical.robot.urdf import read_urdf

ABC = link("a", 1.0) + link("b", 1.0) + link("c", 1.0)
AB = joint("j1", "revolute", "a", "b")
BC = joint("j2", "revolute", "b", "c")

FAULTS = {
    "not XML": ("<robot name='r'><link name='a'>", {}, "malformed XML.*line 1"),
    "another format": ("<sdf><model/></sdf>", {}, "root element is <sdf>, not <robot>"),
    "xacro": (
        robot(ABC, joint("j1", "fixed", "a", "b").replace("0.0", "${x}", 1)),
        {},
        r"is xacro, no URDF; expand it first: xacro arm\.urdf > arm\.expanded\.urdf",
    ),
    "xacro with arguments": (
        robot(ABC, AB).replace('name="j1"', 'name="$(arg prefix)j1"'),
        {},
        r"it asks for the arguments prefix; expand it first: xacro arm\.urdf prefix:=\.\.\. > ",
    ),
    "two numbers": (robot(ABC, joint("j1", "fixed", "a", "b", (1, 2))), {}, "vectors three numbers"),
    "an origin of words": (
        robot(ABC, AB, BC).replace('xyz="0.0 0.0 0.0"', 'xyz="0,0 0 0"', 1),
        {},
        "link 'a': xyz = '0,0 0 0' of its <origin>: allowed: numbers with blanks",
    ),
    "an origin of kilometres": (
        robot(ABC, joint("j1", "revolute", "a", "b", (1e9, 0, 0)), BC),
        {},
        "joint 'j1': xyz = .* of its <origin>: allowed: up to 10000; a URDF has metres",
    ),
    "an origin in degrees": (
        robot(ABC, joint("j1", "revolute", "a", "b", (1, 0, 0), (0, 0, 90)), BC),
        {},
        "joint 'j1': rpy = .* of its <origin>: is more than a turn; a URDF has radians",
    ),
    "a mimic of words": (
        robot(ABC, AB, BC).replace("</joint>", '<mimic joint="j0" offset="x"/></joint>', 1),
        {},
        "joint 'j1': offset = 'x' of its <mimic>: allowed: numbers",
    ),
    "infinite origin": (robot(ABC, joint("j1", "revolute", "a", "b", (1, float("nan"), 0)), BC), {}, "not finite"),
    "links twice": (robot(ABC, link("a"), AB), {}, "link names occur twice: a"),
    "joints twice": (robot(ABC, AB, joint("j1", "revolute", "b", "c")), {}, "joint names occur twice: j1"),
    "no such child": (robot(ABC, joint("j1", "revolute", "a", "x")), {}, "'j1' names link 'x', which is not there"),
    "no such base": (robot(ABC, AB, BC), {"base_link": "x"}, "base_link 'x' is not there; links: a, b, c"),
    "branches": (
        robot(ABC, AB, joint("j2", "revolute", "a", "c")),
        {},
        "branches; its ends are b, c; name .* tip_link",
    ),
    "two roots": (robot(ABC, AB), {}, r"2 links are below no joint \(a, c\); name one as base_link"),
    "wrong way": (robot(ABC, AB, BC), {"base_link": "c", "tip_link": "a"}, "'a' is not below 'c'"),
    "closed loop": (
        robot(ABC, AB, BC, joint("j3", "revolute", "a", "c")),
        {},
        "'c' is below two joints, 'j2' and 'j3'",
    ),
    "link below a ring": (
        robot(link("z") + ABC, AB, joint("j2", "revolute", "b", "a"), joint("j3", "revolute", "b", "z")),
        {},
        "'a' is below itself",
    ),
    "zero axis": (
        robot(ABC, AB, joint("j2", "revolute", "b", "c", axis=(0, 0, 0))),
        {},
        r"'j2' has the axis \[0.0, 0.0",
    ),
    "floating": (robot(ABC, AB, joint("j2", "floating", "b", "c")), {}, "'j2' is of type 'floating'; allowed"),
    "no limits": (robot(ABC, AB, BC.replace("limit ", "limits ")), {}, r"'j2' has the range \[0, 0\]"),
    "nothing moves": (robot(ABC, joint("j1", "fixed", "a", "b"), joint("j2", "fixed", "b", "c")), {}, "no joint moves"),
    "101 joints": (
        robot(
            *(link(f"l{k}") for k in range(102)),
            *(joint(f"j{k}", "revolute", f"l{k}", f"l{k + 1}") for k in range(101)),
        ),
        {},
        "101 joints move between 'l0' and 'l101'; allowed: up to 100",
    ),
    "mimic of a mimic": (
        robot(
            ABC,
            joint("j1", "revolute", "a", "b", extra='<mimic joint="j2"/>'),
            joint("j2", "revolute", "b", "c", extra='<mimic joint="j1"/>'),
        ),
        {},
        "joint 'j1' mimics itself, by way of j1, j2",
    ),
    "5000 links": (robot(*(link(f"l{k}") for k in range(5000))), {}, "has 5000 links; allowed: up to 1000"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_fault(tmp_path, fault):
    text, ends, message = FAULTS[fault]
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_urdf(path, **ends)
    assert str(path) in str(caught.value)


def test_a_joint_that_mimics_one_outside_of_the_chain_has_its_own_reading(tmp_path):
    (tmp_path / "arm.urdf").write_text(
        robot(ABC, AB, joint("j2", "revolute", "b", "c", extra='<mimic joint="other" multiplier="2"/>'))
    )
    arm = read_urdf(tmp_path / "arm.urdf")
    assert [j.coupling for j in arm.joints] == [None, None]
    assert "j2 mimics other, which is not between base and tip: it has its own reading" in arm.notes


def test_no_file(tmp_path):
    with pytest.raises(InputError, match=r"none.urdf: no such file"):
        read_urdf(tmp_path / "none.urdf")


def test_parser_not_installed(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "yourdfpy", None)
    with pytest.raises(InputError, match=r"pip install 'casadical\[urdf\]'"):
        read_urdf(tmp_path / "arm.urdf")
