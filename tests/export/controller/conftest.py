"""Robot files that tests of the controller share."""

import pytest
from controller_arms import NAMES, planted

from casadical.robot.robot_file import write_robot


@pytest.fixture(scope="session")
def files(tmp_path_factory):
    """A folder of robot files with planted errors, by the name of their problem."""
    folder = tmp_path_factory.mktemp("robots")
    for name in NAMES:
        write_robot(planted(name), folder / f"{name}.toml")
    return folder
