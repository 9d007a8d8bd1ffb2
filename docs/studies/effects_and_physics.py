"""Each effect and its counterpart in the engine of the blind check, MuJoCo, which shares no formula with it.

They have the same parameters, computed in pairs_of_effects.py from the counterpart's docstring; nothing is fitted. The
tests compare how far both move the tool at poses of three robots, each against its own simulation without the effect:
|effect - counterpart| / |counterpart| over all poses and coordinates (tests/effects/test_effects_against_physics.py).
Most counterparts are the same physics and agree to second order. Some are built otherwise on purpose (a skewed wave,
hinges in place of a beam, another law of a spring): their limit is wider, and says by how much a right formula may
differ from them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pairs_of_effects as pairs
from counterpart_pairs import ROBOTS, Bench, Pair


@dataclass(frozen=True)
class Case:
    """limit : how far the two may be apart; why : where that is more than second order; robots : that it holds for."""

    name: str
    make: Callable[[Bench], Pair]
    limit: float = 0.01
    why: str = ""
    robots: tuple[str, ...] = ROBOTS


# Limits of what is built otherwise: half as much again as what a right formula shows, rounded up.
SKEWED, LAW = "the wave is skewed", "another law"
CASES = (
    Case("gear_eccentricity", pairs.eccentric_wheel),
    Case("transmission_ripple", pairs.tooth_ripple, 0.15, SKEWED),
    Case("gear_mesh", pairs.mesh, 0.15, SKEWED),
    Case("joint_error_curve", pairs.curve),
    Case("joint_scale", pairs.scale),
    Case("joint_coupling", pairs.coupling),
    Case("joint_zero_step", pairs.jump),
    Case("thermal_zero_drift", pairs.warm_gear),
    Case("thermal_growth", pairs.growth),
    Case("target_shift", pairs.knocked),
    Case("frame_drift", pairs.settling_stand),
    Case("tracker_scale, refraction", pairs.beam_of_light),
    Case("refraction", pairs.beam_from_afar),
    Case("payload_error", pairs.payload),
    Case("link_masses", pairs.links),
    Case("missing_compliance", pairs.soft),
    Case("backlash", pairs.stops_of_play, 0.1, "some poses lie at the threshold"),
    Case("friction_windup", pairs.windup, 0.1, "rubs in the loop's bearings"),
    Case("friction_windup, by load", pairs.windup_by_load, 0.1, "rubs in the loop's bearings"),
    Case("nonlinear_stiffness", pairs.hardening, 0.06, LAW),
    Case("cubic_stiffness", pairs.cubic),
    Case("gravity_compensator", pairs.tendon, 0.03, "acts at the deflected pose"),
    Case("hose_drag", pairs.hose, 0.3, f"{LAW}; axes 4 to 6 meet", ("hh800", "kr210")),
    Case("axis_wobble", pairs.pads),
    # In the engine a parallelogram holds the link's end: the loop carries what the open chain of the effect does not.
    Case("link_flexure", pairs.beam, 0.03, "two hinges; no loop", ("kr210", "ur10e")),
    Case("base_compliance", pairs.pedestal, 0.2, "the foot sinks, too"),
    Case("bearing_play, drop", pairs.sag),
    Case("bearing_play, rock", pairs.rocking_flange),
    Case("frame_step", pairs.slipped_foot),
    Case("frame_step, link", pairs.slipped_flange),
    Case("thermal_bend", pairs.bent_link),
    Case("settling_lag", pairs.too_soon),
    Case("friction_memory", pairs.presliding),
    Case("backlash_by_load", pairs.play_by_load),
    Case("load_hysteresis", pairs.hysteresis, 0.1, "rubs in the loop's bearings"),
    Case("load_hysteresis, square", pairs.inner_friction),
    Case("cross_coupling", pairs.off_diagonal),
    Case("frame_settling", pairs.settling_frame),
    Case("smr_offset", pairs.reflector),
)
