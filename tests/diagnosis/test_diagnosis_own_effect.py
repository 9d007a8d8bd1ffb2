"""A user's own effect: twenty lines, no change to the package."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import casadi as ca
import pytest
from cases import diagnose, robot, simulated

from casadical import InputError, isolability
from casadical.diagnosis.text import as_json, page_of
from casadical.effects import Context, Effect, Law
from casadical.effects.definition import read_definitions
from casadical.effects.motion import motion_effects


@dataclass(frozen=True)
class SaggingCable(Effect):
    """A cable pulls the joint towards its middle, stiffly at the ends of its range."""

    power: float = 3.0

    name: ClassVar[str] = "sagging_cable"
    physics: ClassVar[str] = "A loop of cable is shortest in the middle of its range."
    confused_with: ClassVar[str] = "joint_scale"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {"pull": (20e-6, "rad")}

    def angle(self, context: Context, q: ca.SX) -> ca.SX:
        return -self.value(context, "pull") * ca.sign(q) * ca.fabs(q) ** self.power


def with_cable(pull: float):
    m = simulated("ur10e", 51, n=80)
    q = m.q.copy()
    q[:, 4] -= pull * q[:, 4] ** 3  # to first order in the reading, as the cable does
    r = robot("ur10e")
    f = r.position.map(len(m))
    moved = (f(q.T, r.parameters.values) - f(m.q.T, r.parameters.values)).full().T
    return replace(m, position=m.position + moved)


def test_own_effect_is_diagnosed_beside_the_listed() -> None:
    m = with_cable(50e-6)
    d = diagnose(robot("ur10e"), m, effects=[SaggingCable(5), "backlash", "friction_windup"])
    assert d.verdict == "explained"
    assert [c.label for c in d.causes] == ["sagging_cable@5"]
    value, error, unit = d.causes[0].estimates["pull"]
    assert unit == "rad"
    assert abs(value - 50e-6) < 4 * error + 3e-6
    assert as_json(d, "own")["causes"][0]["effect"] == "sagging_cable"
    assert "A loop of cable is shortest" in " ".join(page_of(d).split())


def test_an_effect_of_a_joint_that_is_not_there_is_refused() -> None:
    with pytest.raises(InputError, match=r"sagging_cable: joint = 9; robot .* has joints 1 to 6"):
        diagnose(robot("ur10e"), with_cable(0.0), effects=[SaggingCable(9)])
    law = Law.from_dict({"joint": 2, "settings": {"formula": "a * q9"}})
    with pytest.raises(InputError, match=r"formula 'a \* q9': q9; robot .* has joints 1 to 6"):
        diagnose(robot("ur10e"), with_cable(0.0), effects=[law])


@pytest.mark.parametrize("ask", [diagnose, isolability])
def test_an_effect_of_a_column_that_is_not_there_is_refused(ask: Callable[..., object], tmp_path: Path) -> None:
    (tmp_path / "damp.effect.toml").write_text(
        'casadical = 2\n[[definition]]\nname = "damp"\nsignature = "s"\nphysics = "p"\nneeds = ["humidity"]\n'
        'sizes = {swelling = [5e-5, "rad"]}\nformulas.joint = "swelling * humidity"\n[[definition]]\nname = "reach"\n'
        'signature = "s"\nphysics = "p"\nsizes = {a = [5e-5, "m"]}\nformulas.distance = "a * sin(q1)"\n'
    )
    effects = [*read_definitions(tmp_path / "damp.effect.toml").values()]
    with pytest.raises(InputError, match=r"none of the chosen.*damp@2 needs humidity.*reach needs far_x"):
        ask(robot("ur10e"), with_cable(0.0), effects=effects)


def test_an_effect_of_joint_logs_is_not_sought_in_poses() -> None:
    tooth = motion_effects()["ripple"](2)
    with pytest.raises(InputError, match="ripple@2: acts at torque, torques, response, responses, in joint logs; name"):
        diagnose(robot("ur10e"), with_cable(0.0), effects=[tooth])


@pytest.mark.parametrize("n", [1, 5])
def test_poses_that_base_and_geometry_absorb_are_refused(n: int) -> None:
    with pytest.raises(InputError, match=rf"absorb all that its {n} rows measure.*measure more poses"):
        diagnose(robot("ur10e"), with_cable(0.0)[:n], effects=["backlash"])


def test_unknown_name_lists_those_that_exist() -> None:
    with pytest.raises(InputError, match="no effect 'backlsh'") as error:
        diagnose(robot("ur10e"), with_cable(0.0), effects=["backlsh"])
    for name in ("backlash", "hose_drag", "standard", "extended"):
        assert name in str(error.value)
