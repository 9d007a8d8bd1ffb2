"""Links and joints of a URDF file as a tree; every fault is an InputError with the file's name."""

import re
from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.dom import minidom

import numpy as np

from casadical.core.basics import Array, InputError, optional, shown
from casadical.core.reading import MAX_ITEMS, foreign, read_xml
from casadical.core.schema import LENGTH


def parse_xml(path: Path, root: str = "robot") -> minidom.Document:
    """Return the file's XML document.

    root : name that its root element must have
    Raises InputError where it is not well-formed, too deep, or its root element is another one.
    """
    data = read_xml(path)
    # Maximum depth of nested XML elements, as of bodies in bodies of a MuJoCo model.
    max_xml_depth = 200
    with foreign(f"{path}: malformed XML"):
        document = minidom.parseString(data)
        element = document.documentElement
        assert element is not None
        row: list[minidom.Node] = [element]
        for _ in range(max_xml_depth):
            row = [child for node in row for child in node.childNodes]
        if row:
            raise ValueError(f"nested more than {max_xml_depth} levels deep")
    if element.tagName != root:
        raise InputError(f"{path}: the root element is <{element.tagName}>, not <{root}>")
    return document


def parse_urdf(path: Path) -> Any:
    """Return the robot of a URDF file as yourdfpy's object, without meshes.

    As yourdfpy repairs broken XML silently, the XML is checked first.

    Raises InputError: yourdfpy is not installed, the XML is malformed, or it is no URDF.
    """
    needed = "reading a URDF needs yourdfpy: pip install 'casadical[urdf]', in a checkout pip install '.[urdf]'"
    yourdfpy = optional("yourdfpy", needed)
    document = parse_xml(path)
    _refuse_xacro(document, str(path))
    _refuse_odd(document, str(path))
    content = BytesIO(document.toxml(encoding="utf-8"))
    needs = "robot, links and joints need a name, joints a type, parent and child, vectors three numbers"
    with foreign(f"{path}: not a readable URDF", f"{needs}; a xacro must be expanded first"):
        return yourdfpy.URDF.load(content, build_scene_graph=False, load_meshes=False).robot


def _refuse_xacro(document: minidom.Document, path: str) -> None:
    """Refuse xacro's elements, and its values where they are read. Raises InputError."""
    read = ("robot", "link", "joint", "parent", "child", "origin", "axis", "limit", "mass", "inertia", "mimic")
    for element in document.getElementsByTagName("*"):
        items = element.attributes.items() if element.tagName in read else ()
        values = [f'{name}="{value}"' for name, value in items if re.search(r"\$[({]", value)]
        if element.tagName.startswith("xacro:") or values:
            inside = f"<{element.tagName}{''.join(f' {value}' for value in values[:1])}>"
            arguments = dict.fromkeys(re.findall(r"\$\(arg (\w+)\)", document.toxml()))
            given = "".join(f" {name}:=..." for name in arguments)
            asked = f"; it asks for the arguments {', '.join(arguments)}" if arguments else ""
            name = Path(path).name
            raise InputError(
                f"{path}: {shown(inside)} is xacro, no URDF{asked}; expand it first: "
                f"xacro {name}{given} > {name.removesuffix('.xacro').removesuffix('.urdf')}.expanded.urdf"
            )


def _refuse_odd(document: minidom.Document, path: str) -> None:
    """Refuse attributes of links and joints that are no numbers, not finite, or too large."""
    # (element of a link or joint, attribute) pairs whose values must be numbers.
    numeric_attributes = (
        ("origin", "xyz"),
        ("origin", "rpy"),
        ("mass", "value"),
        ("limit", "lower"),
        ("limit", "upper"),
        ("mimic", "multiplier"),
        ("mimic", "offset"),
    )
    for owner in [*document.getElementsByTagName("link"), *document.getElementsByTagName("joint")]:
        for tag, key in numeric_attributes:
            for text in (e.getAttribute(key) for e in owner.getElementsByTagName(tag) if e.hasAttribute(key)):
                place = f"{owner.tagName} {owner.getAttribute('name')!r}"
                where = f"{path}: {place}: {key} = {shown(repr(text))} of its <{tag}>"
                try:
                    numbers = [float(part) for part in text.split()]
                except ValueError:
                    raise InputError(
                        f"{where}: allowed: numbers with blanks between them; a xacro must be expanded first"
                    ) from None
                if tag != "limit" and not np.isfinite(numbers).all():
                    raise InputError(f"{where}: is not finite")
                largest = max(map(abs, numbers), default=0.0)
                if key == "rpy" and largest > 6.3:
                    raise InputError(f"{where}: is more than a turn; a URDF has radians, and this looks like degrees")
                if tag in ("origin", "mimic", "mass") and largest > LENGTH.most:
                    raise InputError(f"{where}: allowed: up to {LENGTH.most:g}; a URDF has metres and kilograms")


class Tree:
    """The tree of links.

    source : the file, for messages; names : of the links
    above : link -> joint (yourdfpy's) whose child it is; below : link -> joints whose parent it is
    """

    def __init__(self, urdf: Any, source: str) -> None:
        """Build the tree. Raises InputError: no tree, a name twice, no link or too many."""
        self.source = source
        self.names: list[str] = [link.name for link in urdf.links]
        self.above: dict[str, Any] = {}
        if len(self.names) > MAX_ITEMS:
            raise InputError(f"{source}: has {len(self.names)} links; allowed: up to {MAX_ITEMS}; take the others out")
        self.below: dict[str, list[Any]] = {name: [] for name in self.names}
        for kind, items in (("link", urdf.links), ("joint", urdf.joints)):
            names = [item.name for item in items]
            if twice := sorted({n for n in names if names.count(n) > 1}):
                raise InputError(f"{source}: {kind} names occur twice: {', '.join(twice)}; each must be unique")
        if not self.names:
            raise InputError(f"{source}: holds no link; a xacro must be expanded first")
        for j in urdf.joints:
            for end in (j.parent, j.child):
                if end not in self.below:
                    fault = f"joint {j.name!r} names link {end!r}, which is not there"
                    raise InputError(f"{source}: {fault}")
            if j.child in self.above:
                raise InputError(
                    f"{source}: link {j.child!r} is below two joints, "
                    f"{self.above[j.child].name!r} and {j.name!r}; a URDF is a tree, closed loops "
                    "belong in a robot file"
                )
            self.above[j.child] = j
            self.below[j.parent].append(j)
        for name in self.names:
            link = name
            for _ in self.names:  # a ring above it is reported for its own links
                if link not in self.above:
                    break
                link = self.above[link].parent
                if link == name:
                    raise InputError(f"{source}: link {name!r} is below itself; a URDF is a tree")

    @property
    def root(self) -> str:
        """Return the name of the link that is no joint's child. Raises InputError for several."""
        roots = [name for name in self.names if name not in self.above]
        if len(roots) > 1:
            raise InputError(
                f"{self.source}: {len(roots)} links are below no joint ({', '.join(roots)}); name one as base_link"
            )
        return roots[0]

    def link(self, name: str, role: str) -> str:
        """Return the name if it is a link of the file. Raises InputError otherwise.

        role : of the link in the message, such as "base_link"
        """
        if name not in self.below:
            raise InputError(f"{self.source}: {role} {name!r} is not there; links: {', '.join(self.names)}")
        return name

    def path(self, base: str, tip: str) -> list[Any]:
        """Return the joints (yourdfpy's) between two links, from base to tip, fixed ones included.

        Raises InputError where no chain connects them.
        """
        joints: list[Any] = []
        link: str = tip
        while link != base:
            if link not in self.above:
                raise InputError(f"{self.source}: link {tip!r} is not below {base!r}; no chain connects them")
            joints.append(self.above[link])
            link = joints[-1].parent
        return joints[::-1]

    def only_end(self, base: str) -> str:
        """Return the only end link below `base` that a joint moves, or the link of a gripper.

        Where no joint moves an end, it is the base. A gripper branches at one link, with more
        moving joints before it than in each finger. A branch is no end if joints of a longer one
        mimic all of its joints. Raises InputError for several ends otherwise.
        """
        ends = [link for link, moved in self._walk(base, False) if moved and not self.below[link]]
        if len(ends) < 2:
            return ends[0] if ends else base
        ways = [self.path(base, end) for end in ends]
        common = [joints[0] for joints in zip(*ways, strict=False) if all(j is joints[0] for j in joints)]
        beyond = [[j for j in way[len(common) :] if j.type != "fixed"] for way in ways]
        arm, most = sum(j.type != "fixed" for j in common), max(map(len, beyond))
        if arm <= most:
            # A branch that only leads joints of a longer one, such as a lift's motor, is no end.
            led = {j.mimic.joint for way in beyond if len(way) == most for j in way if j.mimic is not None}
            arms = [e for e, way in zip(ends, beyond, strict=True) if not {j.name for j in way} <= led]
            if len(arms) == 1:
                return arms[0]
            raise InputError(
                f"{self.source}: the chain branches; its ends are {', '.join(ends)}; name the one "
                "that is measured, or on which the gripper is, as tip_link (casadical new: "
                "--tip-link)"
            )
        return str(common[-1].child)

    def _walk(self, link: str, moved: bool) -> Iterator[tuple[str, bool]]:
        """Yield a link and all its descendants, depth first, each with whether a joint moves it.

        That is, whether a joint that is not fixed lies on the way to it.
        """
        waiting = [(link, moved)]
        while waiting:
            link, moved = waiting.pop()
            yield link, moved
            waiting += [(j.child, moved or j.type != "fixed") for j in reversed(self.below[link])]

    def at_zero(self, base: str, moving: Collection[str]) -> tuple[dict[str, Array], dict[str, int]]:
        """Return frames at zero readings of the base and all its descendants, and counts of joints.

        Link -> frame in the base link's frame, (4, 4) [m]; link -> number of the joints between
        base and link whose names are in `moving`.
        """
        frames, movers = {base: np.eye(4)}, {base: 0}
        waiting = [base]
        while waiting:
            link = waiting.pop()
            for j in self.below[link]:
                frames[j.child] = frames[link] @ self.origin(j)
                movers[j.child] = movers[link] + (j.name in moving)
                waiting.append(j.child)
        return frames, movers

    def frame_of(self, link: str) -> Array:
        """Return a link's frame in the root link's at zero readings, shape (4, 4) [m]."""
        T = np.eye(4)
        while link in self.above:
            T = self.origin(self.above[link]) @ T
            link = self.above[link].parent
        return T

    def origin(self, item: Any) -> Array:
        """Return the <origin> of a joint or an <inertial> in its parent's frame, (4, 4) [m].

        It is the identity where none is given. Raises InputError if it is not finite.
        """
        if item.origin is None:
            return np.eye(4)
        if not np.isfinite(item.origin).all():
            raise InputError(f"{self.source}: an origin holds a number that is not finite: {item.origin.tolist()}")
        return np.asarray(item.origin)
