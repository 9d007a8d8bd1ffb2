"""A link that bends: three pieces with springs at the two Gauss points of its length.

The moment is linear from root to end; slope and deflection of the end are integrals of the moment times at most the
remaining length, a quadratic function, which two Gauss points integrate exactly. The link's own mass is distributed
over the pieces so that each spring has the moment of the beam, and all together the link's mass and mass centre.
"""

from xml.etree import ElementTree as ET

import numpy as np

from casadical.core.arrays import Array
from casadical.core.parts import Body
from casadical.core.transforms import frame
from casadical.export.mjcf.elements import add_body, add_mass, add_spring

GAUSS = (0.5 - 0.5 / np.sqrt(3), 0.5 + 0.5 / np.sqrt(3))
AXES = ("1 0 0", "0 1 0", "0 0 1")


def add_pieces(
    body: ET.Element, name: str, mass: Body, end: Array, stiffness: tuple[float, float, float]
) -> tuple[ET.Element, Array]:
    """Pieces of a link, whose body is the first; the last piece, and the link's frame seen from it, shape (4, 4).

    end : where the next joint is, shape (3,) [m]; stiffness : of the whole link about its axes [N m/rad]
    """
    s1, s2 = GAUSS
    com = np.asarray(mass.com)
    # A third of the mass each; centres from the moments (1 - s) m com that the springs must see.
    c2 = s2 * end + 3 * (1 - s2) * com
    c1 = s1 * end + 3 * (1 - s1) * com - (c2 - s1 * end)
    c0 = 3 * com - c1 - c2
    third = mass.mass / 3
    add_mass(body, third, c0)
    before = np.zeros(3)
    for k, (share, centre) in enumerate(zip(GAUSS, (c1, c2), strict=True), 1):
        body = add_body(body, f"{name}_piece{k}", frame(np.eye(3), share * end - before))
        before = share * end
        for axis, words, whole in zip("xyz", AXES, stiffness, strict=True):
            if np.isfinite(whole):
                add_spring(body, f"{name}_bend{k}{axis}", words, 2 * whole)
        add_mass(body, third, centre - before)
    return body, frame(np.eye(3), -before)
