"""The line that drives to a pose says the joints that it was given: the language's own reader finds them."""

import numpy as np
import pytest

from casadical.core.basics import InputError
from casadical.export.controller.programs.program import language_named
from casadical.export.controller.programs.target import Given

JOINTS = [-12.3456, 90.0, -0.0004, 170.25, -33.3333, 5.0]
AROUND = {
    "krl": "DEF p()\n{}\nEND\n",
    "rapid": "MODULE m\nPROC main()\n{}\nENDPROC\nENDMODULE\n",
    "urscript": "def p():\n  {}\nend\n",
    "fanuc": "/PROG P\n/MN\n{}\n/END\n",
}


@pytest.mark.parametrize("word", AROUND)
def test_a_move_line_is_read_again_as_the_same_joints(word: str) -> None:
    language = language_named(word)
    text = AROUND[word].format(language.move_line(JOINTS))
    (target,) = language.targets("p", text, Given(), 6)
    assert target.joints
    np.testing.assert_allclose(np.rad2deg(target.si), JOINTS, atol=6e-4)


def test_a_language_without_motions_says_so() -> None:
    with pytest.raises(InputError, match="has no motion"):
        language_named("csv").move_line(JOINTS)
    with pytest.raises(InputError, match="'cobol': no such language"):
        language_named("cobol")
