"""
7. Your own effect
==================

You suspect an effect that is on no list: the dress pack of the wrist has slack, and pulls only when joint 5 is turned
far out. Write it in twenty lines, and let the diagnosis compare it: does it explain the gap better than all listed
effects? And is it not claimed where it is not the cause?
"""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from casadical import Effect, diagnose, from_table, identify, read_campaign_robot
from casadical.blind_check.mujoco_physics import Hidden, Plant, campaign, perturb
from casadical.identification import errors

ROOT = Path(sys.argv[0]).resolve().parents[2]  # this file lies in docs/tutorials
robot = read_campaign_robot(ROOT / "problems/ur10e")

# %%
# The effect in the model
# -----------------------
# An effect names its parameters with a realistic size each (one sigma before seeing data; zero must mean no effect)
# and overrides the method at which it acts. A spring is potential energy: its torque on every joint, and the
# deflection of the compliant joints, follow automatically. `slack` is a setting. It does not enter linearly, so the
# diagnosis searches around the value given.


@dataclass(frozen=True)
class SlackDressPack(Effect):
    slack: float = 1.2

    name: ClassVar[str] = "slack_dress_pack"
    physics: ClassVar[str] = "A hose with slack pulls its joint back once it is turned out farther than the slack."

    def sizes(self):
        return {"spring": (10.0, "N m/rad")}

    def energy(self, context):
        stretch = ca.fmax(ca.fabs(context.q[self.joint - 1]) - self.slack, 0)
        return 0.5 * self.value(context, "spring") * stretch**2


# %%
# A robot with this effect
# ------------------------
# We test on campaigns of the engine MuJoCo (``pip install 'casadical[withheld]'``), which is independent of the model
# above: there the hose is a spring with slack between links, on a true robot with errors in every link. Its size is how
# far it winds the joint at the end of its range. (For your own robot, use your CSV here.)

nominal = json.loads((ROOT / "data/campaigns/robots/ur10e.json").read_text())
plant = perturb(Plant.from_dict(nominal), seed=11)
end = plant.ranges[4, 1]
hose = Hidden("tight_cable", 5, {"size": 12.0 * (end - 1.0) / plant.stiffness[4], "free": 1.0 / end})


def measured(*hidden):
    """A campaign of 100 poses with these effects hidden in it."""
    return from_table(campaign(plant, hidden, 100, seed=4), robot.n, "position")


with_hose = measured(hose)

# %%
# First the standard list, without it
# -----------------------------------

listed = diagnose(robot, with_hose)
print(listed.verdict, [(c.label, round(c.confidence, 2)) for c in listed.causes])
assert "slack_dress_pack@5" not in [c.label for c in listed.causes]

# %%
# It names the right joint and two wrong causes, with high probability. A probability is relative to the hypotheses
# compared: an effect that is not on the list cannot be found, and smooth errors of one joint resemble each other.
# Therefore it must be easy to add effects to the list.

# %%
# Then with it
# ------------

own = diagnose(robot, with_hose, effects=["standard", SlackDressPack(5)])
(cause,) = own.causes
spring, error, unit = cause.estimates["spring"]
print(f"{own.verdict}: {cause.label}, posterior {cause.confidence:.3f}")
slack = np.rad2deg(cause.effects[0].slack)
print(f"slack {slack:.0f} deg (true: 57), spring {spring:.1f} +- {error:.1f} {unit} (true: 12)")
before, after, floor = 1e3 * np.array([own.gap.before, own.gap.after, own.gap.floor])
print(f"gap {before:.3f} mm, {after:.3f} mm with the cause in the model; noise floor {floor:.3f} mm")
assert (own.verdict, cause.label) == ("explained", "slack_dress_pack@5")
assert own.gap.after < 1.3 * own.gap.floor

# %%
# The spring is a third too stiff, far outside its standard error. The diagnosis uses the model linearised at the base
# fit, which had a wrong compliance of joint 5 to compensate the hose. After identification with the effect in the
# model, both are right.

free = ("kinematic", "compliance")
refit = own.refit()
table = refit.parameters.set_index("name").loc[["c5", "slack_dress_pack@5.spring"]]
print(table[["value", "std_error", "unit"]].round(2).to_string())
print(f"true: c5 {1e6 / plant.stiffness[4]:.1f} urad/(N m), spring 12 N m/rad")
assert abs(table.value["slack_dress_pack@5.spring"] / 12 - 1) < 0.1
assert abs(table.value["c5"] / (1e6 / plant.stiffness[4]) - 1) < 0.05

# %%
# Test it on other poses
# ----------------------
# Identify with the first 70 poses, test with the last 30. The two wrong causes predict as well as the right one: with
# five parameters they reproduce a smooth torque of one joint. Prediction cannot distinguish them. The posterior does:
# it is unlikely that five parameters agree by chance, and likely that one has a realistic size.

early, late = with_hose[:70], with_hose[70:]


def left_mm(model):
    """Mean error [mm] on the last 30 poses of a model identified from the first 70."""
    fitted = identify(model, early, (*free, *(e.label for e in model.effects)), priors=True)
    return 1e3 * errors(fitted.robot, late).mean()


left = {
    "base": left_mm(robot),
    "standard list": left_mm(robot.with_effect(*listed.effects())),
    "own effect": left_mm(robot.with_effect(*own.effects())),
}
for name, value in left.items():
    print(f"{name:14s} {value:.3f} mm")
assert max(left["own effect"], left["standard list"]) < 0.2 * left["base"]

q5 = np.rad2deg(with_hose.q[:, 4])
figure, ax = plt.subplots(figsize=(8, 3.4), layout="constrained")
for name, fitted in (("base", identify(robot, with_hose, free, priors=True)), ("own effect", refit)):
    ax.plot(q5, 1e3 * errors(fitted.robot, with_hose), "o", markersize=4, label=name)
ax.set(xlabel="joint 5 [deg]", ylabel="error [mm]")
ax.legend()
plt.show()

# %%
# Is it claimed only where it is the cause?
# -----------------------------------------
# An effect that explains everything is useless, too. We test the same robot twice: with nothing hidden, and with
# friction in joint 3.

for name, hidden, expected in (
    ("nothing hidden", (), []),
    ("friction in joint 3", (Hidden("friction_windup", 3, {"size": 60e-6, "load_share": 0.8}),), ["friction_windup@3"]),
):
    answer = diagnose(robot, measured(*hidden), effects=["standard", SlackDressPack(5)])
    print(f"{name}: {answer.verdict}", [c.label for c in answer.causes])
    assert [c.label for c in answer.causes] == expected

# %%
# More
# ----
# :doc:`/diagnosis` lists the methods to override and all effects; each effect is one short file in
# ``casadical/effects``.
