# ruff: noqa: E501
"""Mutants that an audit found alive against the file of tests nearest to each, and mutants of the draw that change
nothing a caller can see. What the package no longer has (the exponent of detection, of the audit) is left out."""

from __future__ import annotations

# File, what stands there (once), what is put in its place, and what that means.
LISTED = (
    ("diagnosis/posterior.py", '"unknown": 0.15}', '"unknown": 0.015}', "prior of the unknown"),
    ("diagnosis/posterior.py", "SAME_JOINT = 0.05", "SAME_JOINT = 0.5", "a second cause at a joint"),
    ("diagnosis/noise_floor.py", "Noise(scale * noise.sigma, scale * noise.repeatability)",
     "Noise(scale * noise.sigma, noise.repeatability)", "scale of repeatability"),
    ("diagnosis/noise_floor.py", "wide = -3 * np.log", "wide = -2 * np.log", "-3 log of a pose's noise"),
    ("diagnosis/conclusion.py", "distance[out][0] < 2 * thresholds.OUT", "distance[out][0] < thresholds.OUT", "limit of one outlier"),
    ("diagnosis/settings_search.py", "log[best] - log[0] < GAIN", "log[best] - log[0] < -GAIN", "sign of GAIN"),
    ("diagnosis/line_search.py", "most - 2 * np.log(RIVAL)", "most + 2 * np.log(RIVAL)", "rivals of a line"),
    ("diagnosis/line_search.py", "if g < most / 2]", "if g > most / 2]", "rivals of a line, beside it"),
    ("fleet/comparison.py", "YEAR, CAMPAIGNS = 365.25", "YEAR, CAMPAIGNS = 36.525", "YEAR"),
    ("fleet/comparison.py", "(1 - HAZARD) ** (k - 1)", "(1 - HAZARD) ** k", "HAZARD's exponent"),
    ("fleet/comparison.py", "('sine', 'cosine')[w]", "('cosine', 'sine')[w]", "sine for cosine"),
    ("fleet/comparison.py", "Amount(name, 1e6 * a[w]", "Amount(name, 1e3 * a[w]", "1e6 for 1e3"),
    ("fleet/run.py", 'row.status != "ok"', 'row.status == "ok"', "a robot that failed is computed again"),
    ("measurements/derived_columns.py", "np.exp(-abs(move) / way)", "np.exp(abs(move) / way)", "which way memory runs"),
    ("measurements/columns.py", '"temperature_degC": (-273.15,', '"temperature_degC": (-2731.5,', "-273.15"),
    ("export/controller/inverse.py", "LENGTH = 0.3", "LENGTH = 3.0", "LENGTH"),
    ("export/controller/functions.py", "[q, ca.SX(before)], [dq, change])", "[q, ca.SX(before)], [dq, -change])",
     "before and after swapped"),
    ("export/controller/inverse.py", "np.clip(np.round((near - found) / _TURN), least, most)",
     "np.round((near - found) / _TURN)", "clip of a turn"),
    ("project/check/plausible.py", "freedom = len(m) - distinct", "freedom = len(m)", "freedom of repeats"),
    ("project/check/plausible.py", "first_of_best(-np.log(", "first_of_best(np.log(", "sign of what is plausible"),
    ("project/check/information.py", "left, free = r - Q @ (Q.T @ r)", "left, free = r + Q @ (Q.T @ r)", "sign"),
    ("project/check/slip_fit.py", "return self.q[shift:], self.y[: n - shift]",
     "return self.q[: n - shift], self.y[shift:]", "alignment of a shift"),
    ("project/check/slip_fit.py", "(moved + 1) // 2", "moved", "count of swaps"),
    ("project/check/targets.py", "DISAGREE, SAME = 0.5, 0.7", "DISAGREE, SAME = 0.5, 0.07", "cut-off of targets"),
    ("project/verification.py", "(freedom + made_up) / freedom", "freedom / (freedom + made_up)",
     "`made_up` of verify"),
)  # fmt: skip

# Mutants of the draw that lived and do not differ from the original for a caller: file and change, and why.
EQUIVALENT: dict[str, str] = {
    "diagnosis/motion/response.py NumberReplacer 241: step = np.linalg.solve(H + damping[:, None, None] * H * np.eye(LOCAL), b[..., None])[..., 0] => step = np.linalg.solve(H + damping[:, None, None] * H * np.eye(LOCAL), b[..., None])[..., -1]": "there is one right-hand side: the last is the first",
    "diagnosis/spectrum.py ReplaceComparisonOperator_Eq_LtE 3: f\"{reduction}, {'once' if times == 1 else 'twice'} a motor turn\" => f\"{reduction}, {'once' if times <= 1 else 'twice'} a motor turn\"": "it is one or two",
    "core/linear_gaussian/columns.py ReplaceComparisonOperator_Eq_Lt 2: return slice(columns[0], columns[-1] + 1) if (np.diff(columns) == 1).all() else columns => return slice(columns[0], columns[-1] + 1) if (np.diff(columns) < 1).all() else columns": "columns rise, so that all are taken by number, the same ones: time alone",
    "core/linear_gaussian/marginals.py NumberReplacer 63: return value, vector.T @ every.combine(chosen.b[k][group][:, 0]) => return value, vector.T @ every.combine(chosen.b[k][group][:, -1])": "what is left is one column: the last is the first",
    "core/sx_instructions.py ReplaceTrueWithFalse 1: for place, value in zip(results, call([work[k] for k in operands]), strict=True): => for place, value in zip(results, call([work[k] for k in operands]), strict=False):": "a call gives as many results as CasADi's instruction has places for",
    "effects/formula_effect.py RemoveDecorator 0:  => class FormulaEffect(Effect):": "a class without fields of its own has those of its base",
    "effects/formula.py ReplaceTrueWithFalse 0: @dataclass(frozen=True) => @dataclass(frozen=False)": "frozen keeps from assigning; nothing assigns",
    "robot/model.py RemoveDecorator 11:  => def expressions(structure: Structure, fixed_loads: bool = False) -> Expressions:": "expressions are composed again, and are the same: time alone",
    "robot/model.py ReplaceComparisonOperator_Is_IsNot 2: (j.kind, j.beta is None, j.b is None, j.compliance is None, j.body and (j.body.mass, *j.body.com)) => (j.kind, j.beta is None, j.b is None, j.compliance is not None, j.body and (j.body.mass, *j.body.com))": "part of a key, one to one",
    "robot/robot_schema.py NumberReplacer 28: xx, xy, xz, yy, yz, zz = self.inertia_kgm2 or [0.0] * 6 => xx, xy, xz, yy, yz, zz = self.inertia_kgm2 or [ 1.0] * 6": "moments were asked for only where they are given; the branch is gone since",
    "measurements/headings.py NumberReplacer 89: factor = UNITS[whole[0].unit][1] if whole[0].unit else next((f for most, f in _STAMPS if size < most), 1e-9) => factor = UNITS[whole[ -1].unit][1] if whole[0].unit else next((f for most, f in _STAMPS if size < most), 1e-9)": "one heading alone comes there: the last is the first",
    "identification/misfit.py NumberReplacer 72: out = [(0, 0), (0, width - r.shape[1])] => out = [(0, 0), ( 1, width - r.shape[1])]": "one more column of zeros, which adds nothing to a sum",
    "identification/least_squares.py NumberReplacer 40: scale = 0.5 * self.residual_count => scale = 1.5 * self.residual_count": "the unit in which the solver counts the cost",
    "identification/residuals.py ReplaceComparisonOperator_LtE_GtE 1: whole = data(m, slice(None)) if len(m) <= HELD else None => whole = data(m, slice(None)) if len(m) >= HELD else None": "which numbers are held in memory: time alone",
    "identification/reduction.py ReplaceTrueWithFalse 1: places, origin = zip(problem.labels, problem.points, strict=True), problem.robot.base.T[:3, 3] => places, origin = zip(problem.labels, problem.points, strict=False), problem.robot.base.T[:3, 3]": "both have the same length wherever they are made",
    "pose_selection/selection.py NumberReplacer 2: A = rows.reshape(-1, rows.shape[2]) => A = rows.reshape(- 2, rows.shape[2])": "numpy takes any negative number for the dimension that is left",
    "compensator/report.py ReplaceTrueWithFalse 1: @dataclass(frozen=True) => @dataclass(frozen=False)": "frozen keeps from assigning; nothing assigns",
    "identification/placement.py NumberReplacer 70: turns = {tuple(np.round(from_xyz(np.array(a) * np.pi / 2), 6).ravel()) for a in product(range(4), repeat=3)} => turns = {tuple(np.round(from_xyz(np.array(a) * np.pi / 2), 6).ravel()) for a in product(range( 5), repeat=3)}": "a fifth quarter turn is the first one: a set",
}
