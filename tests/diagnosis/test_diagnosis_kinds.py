"""Other kinds of measurement, and several sessions: columns, named causes, held-out errors, mixed sets."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from cases import diagnose, identified, practice, robot, simulated

from casadical.core.basics import InputError
from casadical.core.parts import Sessions, Target
from casadical.core.transforms import frame, from_rpy
from casadical.diagnosis.candidates import candidates_of
from casadical.diagnosis.details import Details, analyse
from casadical.diagnosis.diagnose import Diagnosis
from casadical.diagnosis.linear_problem import make_case, unsure_tables
from casadical.diagnosis.localisation import localise
from casadical.diagnosis.next_poses import next_poses
from casadical.diagnosis.noise_forms import AR_NOISE
from casadical.diagnosis.observations import Stops, _by_stop, scales_of, stops_in
from casadical.diagnosis.statements import assumptions, statements, wires_at_fault
from casadical.diagnosis.text import as_json, page_of
from casadical.effects import Backlash, ThermalGrowth, WireDrift
from casadical.identification.accuracy import errors, predicted
from casadical.identification.identification import calibrate_base_model, identify, prepare
from casadical.identification.residuals import make_block
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

ANCHORS = np.array([[2.5, 0.5, 0.2], [-1.0, 2.5, 0.5], [0.3, -2.2, 2.0]])


def distances(m: Measurements, anchors: np.ndarray = ANCHORS) -> tuple[Measurements, ...]:
    """The measured positions as distances to anchors, a set for each."""
    assert m.position is not None
    ends = [np.tile(anchor, (len(m), 1)) for anchor in anchors]
    read = zip([np.linalg.norm(m.position - end, axis=1) for end in ends], ends, strict=True)
    empty = Measurements(m.q, "distance", distance=np.ones(len(m)), conditions=m.conditions)
    return tuple(replace(empty, distance=distance, target=end) for distance, end in read)


def pairs(m: Measurements) -> Measurements:
    """Each position's distance to the one half the campaign later."""
    assert m.position is not None
    far = np.roll(np.arange(len(m)), len(m) // 2)
    apart = np.linalg.norm(m.position - m.position[far], axis=1)
    return Measurements(m.q, "pair_distance", distance=apart, other=m.q[far])


def poses(m: Measurements, seed: int = 0) -> Measurements:
    """The positions with orientations of the calibrated robot, in error by .1 mrad an angle."""
    assert m.position is not None
    _, R = predicted(identified("hh800-P01").robot, m)
    a = np.random.default_rng(seed).normal(0.0, 1e-4, (len(m), 3))
    zero = np.zeros(len(m))
    turn = np.array([[zero, -a[:, 2], a[:, 1]], [a[:, 2], zero, -a[:, 0]], [-a[:, 1], a[:, 0], zero]])
    turned = (np.eye(3) + turn.transpose(2, 0, 1)) @ R
    U, _, V = np.linalg.svd(turned)
    return Measurements(m.q, "pose", position=m.position, orientation=U @ V, conditions=m.conditions)


@cache
def by_distances() -> Diagnosis:
    return diagnose(robot("kr210"), distances(practice("kr210-P02")), ["thermal_growth", "frame_drift", "backlash"])


def motions(m: Measurements) -> Measurements:
    """From each pose to the next, in the tool's frame."""
    whole = poses(m)
    assert whole.orientation is not None
    assert whole.position is not None
    R, p = whole.orientation, whole.position
    shift = np.einsum("nji,nj->ni", R[:-1], p[1:] - p[:-1])
    turn = np.einsum("nji,njk->nik", R[:-1], R[1:])
    conditions = {name: values[1:] for name, values in m.conditions.items()}
    extra = {"shift": shift, "turn": turn}
    return Measurements(m.q[1:], "relative_pose", other=m.q[:-1], extra=extra, conditions=conditions)


@pytest.mark.parametrize(
    "kind", ["distance", "pair_distance", "pose", "contact", "plane", "sphere", "dial", "relative_pose"]
)
def test_columns_of_the_base_model_are_those_of_the_kinds_own_residual(kind: str) -> None:
    m = practice("hh800-P01")[:24]
    made = {
        "distance": lambda: distances(m)[0],
        "pair_distance": lambda: pairs(m),
        "pose": lambda: poses(m),
        "contact": lambda: Measurements(m.q, "contact", label=np.array(["A", "B"] * 12)),
        "plane": lambda: Measurements(m.q, "plane", label=np.array(["A", "B"] * 12)),
        "sphere": lambda: replace(distances(m)[0], kind="sphere", label=np.array(["A"] * 24), target=None),
        "dial": lambda: Measurements(m.q, "dial", extra={"reading": m.position @ [0.6, 0.0, 0.8]}),
        "relative_pose": lambda: motions(m),
    }[kind]()
    found = identify(robot("hh800"), made, ("geometry",), priors=True)
    case = make_case(found, [])
    names, labels = found.given.parameters.select(["geometry"]), found.problem.labels
    points = np.array([*found.unknown_points.values()]).reshape(-1, 3)
    group = np.arange(len(made)) % max(len(labels), 1)
    block = make_block(found.robot, made, names, *found.problem.sigmas[0], points, group)
    r, J = block.evaluate(np.zeros(len(names)), np.zeros((max(len(labels), 1), 3)))
    # In units of sigma and of the parameters' scales there; in metres and SI units here.
    sigma = found.problem.sigmas[0][0]
    scale = np.array([found.given.parameters[n].scale for n in names])
    at = [found.given.parameters.index_of(n) for n in names]
    np.testing.assert_allclose(case.whole.r, -sigma * r, rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(case.base.J[:, :, at] * scale, sigma * J[:, :, : len(names)], rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("kind", ["distance", "pair_distance"])
def test_columns_of_an_effect_are_what_it_changes_in_the_readings(kind: str) -> None:
    m = practice("kr210-P02")[:20]
    made = distances(m)[0] if kind == "distance" else pairs(m)
    made = made if kind == "distance" else replace(made, conditions=m.conditions)
    found = identify(robot("kr210"), made, ("geometry",), priors=True)
    effects = [ThermalGrowth(), *[*Backlash.candidates(robot("kr210"))][:1]]
    case = make_case(found, candidates_of(robot("kr210"), effects))
    for effect in effects:
        columns = case.columns[effect]
        E = case.whole.take(columns)
        changed = found.robot.with_effect(effect)
        names = [p.name for p in changed.parameters if p.group == effect.label]
        for k, (name, (size, _)) in enumerate(zip(names, effect.sizes().values(), strict=True)):
            more, less = (readings(changed.with_values({name: s * size}), case.m, made) for s in (1e-3, -1e-3))
            np.testing.assert_allclose(E[:, 0, k], (more - less) / 2e-3, rtol=1e-3, atol=1e-9)


def readings(r: Robot, m: Measurements, made: Measurements) -> np.ndarray:
    """What a robot would read, shape (n,) [m]; m : the poses with all conditions."""
    where, _ = predicted(r, m)
    far = made.target if made.other is None else predicted(r, replace(m, q=made.other))[0]
    return np.asarray(np.linalg.norm(where - far, axis=1))


def test_what_an_instrument_does_to_its_reading_it_does_to_no_other_of_the_stop() -> None:
    """Columns of a drift of each wire at stops with three readings: finite differences of each wire's own reading."""
    sets = distances(practice("kr210-P02")[:20])
    found = identify(robot("kr210"), sets, ("geometry",), priors=True)
    effect = WireDrift()
    case = make_case(found, candidates_of(robot("kr210"), [effect]))
    assert case.observations.r.shape == (20, 3)
    E = case.whole.take(case.columns[effect])
    changed = found.robot.with_effect(effect)
    for k, (name, (size, _)) in enumerate(effect.sizes().items()):
        values = {f"{effect.label}.{name}": 1e-2 * size}
        for j, m in enumerate(case.observations.sets):
            more = readings(changed.with_values(values), m, m) - readings(found.robot, m, m)
            scale = scales_of(case.observations.sigmas, j)[0]
            np.testing.assert_allclose(E[:, j, k], 1e2 * scale * more, rtol=1e-3, atol=1e-9)


def test_rows_of_one_stop_are_one_pose_whatever_table_they_are_in() -> None:
    m = practice("hh800-P01")[:10]
    first, second, third = distances(m)
    stops = stops_in([first, second[np.array([4, 2, 9])], third[:5]])
    assert len(stops.rows) == 10
    assert stops.of.tolist() == [*range(10), 4, 2, 9, *range(5)]
    assert stops.turn.tolist() == [0] * 10 + [1] * 3 + [1, 1, 2, 1, 2]
    kept = np.arange(10) != 2
    assert stops.indices_among(kept).tolist() == [0, 1, *range(2, 9), 3, 8, 0, 1, 2, 3]


def test_a_robot_that_went_elsewhere_between_stopped_twice() -> None:
    m = practice("hh800-P01")[:6]
    first, second, _ = distances(m)
    numbers = np.arange(1.0, 7.0)
    logged = [replace(a, conditions={"pose": numbers + k}) for a, k in ((first, 0.0), (second, 6.0))]
    # The last pose of the first table and the first of the second are different readings, so all stops are apart.
    assert len(stops_in(logged).rows) == 12
    assert len(stops_in([replace(a, conditions={}) for a in (first, second)]).rows) == 6
    assert len(stops_in([first, first]).rows) == 6
    # What one instrument reads again to the same end is read at another stop.
    assert len(stops_in([first[np.array([0, 0, 1])]]).rows) == 3


def test_distances_to_three_anchors_name_the_cause_that_positions_name() -> None:
    found = by_distances()
    assert found.verdict == "explained"
    assert [c.label for c in found.causes] == ["thermal_growth"]
    assert found.case.evidence.count == 3 * 60
    assert found.gap.after < 0.6 * found.gap.without_outliers
    assert any("rows were read at 60 stops" in text for text in assumptions(found))


def test_everything_that_a_report_needs_is_made_of_distances() -> None:
    found = by_distances()
    more = analyse(found)
    assert more.check is not None
    assert more.check.agree
    assert more.where is not None
    assert more.where.directions.empty
    assert len(more.where.joints)
    assert as_json(found, "distances", more)["verdict"] == "explained"
    assert any("distance" in s.text for s in statements(found, more) if s.about == "ASSUMED")
    # What to measure next is read as this was, by distances.
    further = next_poses(found, 2, ["thermal_growth", "frame_drift"], pool=60)
    assert "distance_mm" in further
    assert "x_mm" not in further


@pytest.mark.parametrize("sigma", [1e-4, *(pytest.param(s, marks=pytest.mark.slow) for s in (1e-6, 1e-5, 1e-3, 1e-2))])
def test_instruments_from_a_micrometre_to_a_centimetre_raise_no_alarm(sigma: float) -> None:
    """Positions and three wires at the same stops, of a robot that is off in its geometry alone."""
    rng, kr210 = np.random.default_rng(7), robot("kr210")
    geometry = [p for p in kr210.parameters.select(["geometry"]) if not p.startswith("base_")]
    real = kr210.with_values({n: kr210.parameters[n].value + rng.normal(0, 2e-4) for n in geometry})
    m = practice("kr210-P02")[:60]
    exact = replace(m, position=predicted(real, m)[0])
    assert exact.position is not None
    read = replace(exact, position=exact.position + rng.normal(0, sigma, (60, 3)))
    wires = [replace(w, distance=w.distance + rng.normal(0, sigma, 60)) for w in distances(exact)]
    found = diagnose(kr210, [read[:30], *wires], ["backlash", "thermal_growth", "transmission_ripple"])
    assert found.verdict == "none"
    # The instruments' and the joints' noise together; coarse ones hardly tell one from the other.
    arm = np.sqrt((found.case.evidence.Jq**2).sum() / found.case.evidence.count)
    assert 0.5 < np.hypot(found.noise.sigma, found.noise.repeatability * arm) / sigma < 1.5


WALL = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "shown"),
    [
        (lambda r: r, {"base_rx", "base_ry"}),
        (
            lambda r: replace(r, base=replace(r.base, T=WALL)),
            {"base_ry", "base_rz"},
        ),  # on a wall rx turns about the vertical
        (lambda r: replace(r, gravity_frame="base"), set()),
        (lambda r: replace(r, joints=tuple(replace(j, compliance=1e-3 * j.compliance) for j in r.joints)), set()),
    ],
    ids=["floor", "wall", "known weight", "stiff"],
)
def test_turns_of_a_foot_are_those_that_the_weight_shows_better_than_their_priors(changed, shown) -> None:
    rng, arm, m = np.random.default_rng(7), changed(robot("kr210")), practice("kr210-P02")
    real = arm.with_values(dict.fromkeys(shown, 0.02))
    exact = distances(replace(m, position=predicted(real, m)[0]))
    wires = [replace(w, target=None, distance=w.distance + rng.normal(0, 2e-5, len(m))) for w in exact]
    found = calibrate_base_model(prepare(arm, wires))
    assert {n for n in found.names if n.startswith(("base_", "alpha0", "d1"))} == shown
    known = zip(found.names, found.estimate, found.standard_errors, strict=True)
    assert all(abs(value - 0.02) < 4 * error for name, value, error in known if name in shown)


@pytest.mark.slow
def test_angles_have_a_noise_of_their_own() -> None:
    m = poses(practice("hh800-P01"))
    found = diagnose(robot("hh800"), m, ["backlash", "joint_coupling"])
    assert [c.label for c in found.causes] == ["backlash@5"]
    assert not found.case.observations.plain
    length, angle = scales_of(found.case.observations.sigmas, 0)
    assert length == 1.0
    # .1 mrad were put in.
    assert found.noise.sigma / angle == pytest.approx(1e-4, rel=0.3)


@pytest.mark.slow
def test_orientations_of_another_convention_are_left_aside_and_said() -> None:
    m = poses(practice("hh800-P01"))
    assert m.orientation is not None
    other = replace(m, orientation=m.orientation.transpose(0, 2, 1))
    found = diagnose(robot("hh800"), other, ["backlash"])
    assert found.case.observations.plain
    assert any("convention" in said for said in found.case.assumed)


@pytest.mark.slow
def test_sets_of_two_kinds_have_noise_of_their_own() -> None:
    m = practice("hh800-P01")
    rng = np.random.default_rng(0)
    coarse = distances(m[:60], ANCHORS[:1])[0]
    assert coarse.distance is not None
    coarse = replace(coarse, distance=coarse.distance + rng.normal(0.0, 2e-4, 60))
    found = diagnose(robot("hh800"), [m[60:], coarse], ["backlash"])
    assert not found.case.observations.plain
    # .2 mm were put in.
    assert found.noise.sigma / scales_of(found.case.observations.sigmas, 1)[0] == pytest.approx(2e-4, rel=0.3)
    assert [c.label for c in found.causes] == ["backlash@5"]


def test_the_noise_of_small_tables_over_the_others_is_unsure() -> None:
    """Of three tables of 60 distances one tells the others' noise, unless one declares its own."""
    seen = by_distances().case.observations
    counts = [int(mask.sum()) for mask in unsure_tables(seen)]
    assert counts == [len(seen.m)] * 2 == [int(mask.sum()) for mask in by_distances().case.whole.unsure]
    told = replace(seen, sets=(replace(seen.sets[0], sigma=1e-5), *seen.sets[1:]))
    (first, second), own = unsure_tables(told), seen.layout
    for mask, poses, places in zip((first, second), own.poses[1:], own.places[1:], strict=True):
        assert mask[poses, places].all()
    told = replace(seen, sets=tuple(replace(m, sigma=1e-5) for m in seen.sets))
    assert not unsure_tables(told)


def test_poses_that_hold_one_point_are_spread_over_the_folds() -> None:
    m = practice("hh800-P01")[:40]
    touched = Measurements(m.q, "contact", label=np.repeat(["A", "B", "C", "D"], 10))
    case = make_case(identify(robot("hh800"), touched, ("geometry",), priors=True), [])
    assert case.evidence.alike is not None
    assert len(np.unique(case.evidence.alike)) == 4


def test_targets_that_share_few_stops_promise_what_other_stops_show() -> None:
    """Joints that repeat badly err alike for all targets of a stop, and a curve through seven angles is no cause."""
    tip = robot("kr210").tool.T[:3, 3]
    more = tuple(Target(name, tip + 0.1 * np.eye(3)[k]) for k, name in enumerate("BC"))
    arm = replace(robot("kr210"), tool_name="A", targets=more)
    low, high, rng = *arm.limits, np.random.default_rng(4)
    levels = np.linspace(0.9 * low + 0.1 * high, 0.1 * low + 0.9 * high, 7)

    def measured(stops: int) -> Measurements:
        """Three targets at each of some stops, whose joints repeat to 40 urad, with noise of 30 um."""
        q = np.repeat(np.column_stack([rng.choice(levels[:, j], stops) for j in range(6)]), 3, axis=0)
        flags = {f"tool_{name}": np.tile(np.eye(3)[k], stops) for k, name in enumerate("ABC")}
        flags |= {c: np.full(len(q), v) for c, v in zip(arm.conditions, arm.declared, strict=True) if c not in flags}
        off = np.repeat(rng.normal(0, 4e-5, (stops, 6)), 3, axis=0)
        blank = Measurements(q + off, "position", position=np.zeros((len(q), 3)), conditions=flags)
        p = predicted(arm, blank)[0]
        return replace(blank, q=q, position=p + rng.normal(0, 3e-5, p.shape))

    found, others = diagnose(arm, measured(36), ["joint_error_curve", "transmission_ripple"]), measured(300)
    assert found.causes == ()
    assert found.case.evidence.poses_per_stop == pytest.approx(3, abs=0.2)
    assert AR_NOISE not in found.rankings[0].probability
    assert found.gap.after == pytest.approx(errors(found.identification.robot, others).mean(), rel=0.25)


def test_a_wire_that_slips_twice_has_two_steps_at_their_rows() -> None:
    """Each lies between the two readings that it parts; alone, neither is larger than what is left by the other."""
    m = practice("kr210-P08")[:100]
    wire = distances(m)[0]
    assert wire.distance is not None
    row = np.arange(len(m))
    slipped = replace(wire, distance=wire.distance + 5e-4 * (row >= 23) - 5e-4 * (row >= 44))
    found = diagnose(robot("kr210"), slipped, ["wire_step", "station_step", "wire_drift", "backlash"])
    assert {c.label: c.effect for c in found.causes} == {"wire_step": "wire_step", "wire_step#2": "wire_step"}
    time = found.case.progress
    jumps = sorted((c.effects[0].at, *c.estimates["step1"][:2]) for c in found.causes if c.estimates)  # type: ignore[attr-defined]
    for (at, size, error), first, true in zip(jumps, (23, 44), (5e-4, -5e-4), strict=True):
        assert time[first - 1] < at < time[first]
        assert abs(size - true) < 4 * error
    assert not [c.label for c in found.case.candidates if c.label.endswith("#3")]


def test_a_step_makes_no_outliers_when_causes_are_searched_again_with_the_noise_beside_it() -> None:
    """The step is most of the wire's noise in the base model; to the noise that remains every pose deviates."""
    m = practice("kr210-P08")[:40]
    wire = distances(m)[0]
    assert wire.distance is not None
    row = np.arange(len(m))
    slipped = replace(wire, distance=wire.distance + 1e-3 * (row >= 20))
    found = diagnose(robot("kr210"), [m, slipped], ["wire_step"], laws=False)
    # The noise of the wire was estimated again, without its step.
    assert found.case.observations.sigmas[1][0] < 1e-4
    assert found.case.inliers.all()
    assert [c.label for c in found.causes] == ["wire_step"]
    time = found.case.progress
    assert time[19] < found.causes[0].effects[0].at < time[20]  # type: ignore[attr-defined]


@pytest.mark.slow
def test_a_wire_that_drifts_is_named_and_no_cause_in_the_robot() -> None:
    m = practice("kr210-P08")[:60]
    first, second, third = distances(m)
    assert second.distance is not None
    late = np.linspace(-0.5, 0.5, len(m))
    drifting = replace(second, distance=second.distance + 2e-4 * late)
    sets = [replace(s, source=f"wire{k}.csv") for k, s in enumerate((first, drifting, third), 1)]
    found = diagnose(robot("kr210"), sets)
    assert [c.label for c in found.causes] == ["wire_drift"]
    estimates = found.causes[0].estimates
    assert estimates is not None
    assert [*estimates] == ["drift1", "drift2", "drift3"]
    assert estimates["drift2"][0] == pytest.approx(2e-4, rel=0.15)
    assert found.refit().is_optimal()
    where = localise(found)
    assert where.links.set_index("part")["share"]["instrument"] > 0.8
    text = page_of(found, Details(where))
    ((which, size),) = wires_at_fault(found, found.causes[0]).items()
    assert (which, size.partition(" ")[0]) == ("wire2.csv", "drift")
    assert "check wire2.csv, calibrate without" in " ".join(text.split())
    # Where something is left, the noise that nobody declared is a doubt.
    left = statements(replace(found, verdict="unknown", unknown_rest=0.5))
    assert "declare sigma_mm of each" in next(s.text for s in left if s.about == "UNKNOWN")
    # What the instrument does is not in the robot: at rest it is where it was.
    np.testing.assert_allclose(predicted(found.apply(), m)[0], predicted(found.identification.robot, m)[0], atol=2e-4)


def test_a_robot_that_fits_hardly_any_pose_is_refused() -> None:
    case = make_case(identified("hh800-P01"), [])
    few = np.arange(len(case.inliers)) < len(case.inliers) // 3
    with pytest.raises(InputError, match="poses are far off; check the signs and zeros of the joints"):
        case.screened(few)


def in_two_sessions(m: Measurements, moved: np.ndarray) -> Measurements:
    """The second half of a campaign measured from another place; moved : (4, 4) of the instrument."""
    later = np.arange(len(m)) >= len(m) // 2
    p = np.where(later[:, None], m.position @ moved[:3, :3].T + moved[:3, 3], m.position)
    return replace(m, position=p, conditions={**m.conditions, "session_a": 1.0 - later, "session_b": 1.0 * later})


@pytest.mark.slow
def test_a_moved_foot_is_a_cause_where_the_base_is_said_to_be_shared() -> None:
    near = frame(from_rpy(np.array([2e-4, -1e-4, 1e-4])), np.array([1e-4, 2e-4, -1e-4]))
    shared = replace(robot("ur10e"), sessions=Sessions(base="shared", tool="shared", zeros="shared"))
    d = diagnose(shared, in_two_sessions(simulated("ur10e", 21, n=70), near))
    assert (d.verdict, [c.label for c in d.causes]) == ("explained", ["frame_step"])


def test_a_stop_of_fewer_rows_is_no_other_one_with_more() -> None:
    stops = Stops(np.array([0, 1, 1]), np.array([0, 0, 1]), np.array([0, 1]))
    assert _by_stop(stops, np.array([0, 0, 1])).tolist() == [[0, -1], [0, 1]]
