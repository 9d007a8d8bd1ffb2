# ruff: noqa: E501
"""Mutants of the draw that change nothing a caller can see, for mutants.py: file and change, and why."""

from __future__ import annotations

EQUIVALENT: dict[str, str] = {
    "blind_check/mujoco_physics/equilibrium.py ReplaceComparisonOperator_Lt_LtE 0: if np.abs(self.data.qvel).max() < creep: => if np.abs(self.data.qvel).max() <= creep:": "a speed that equals the threshold to the last digit",
    "cli/withheld.py AddNot 0: if TYPE_CHECKING: => if not TYPE_CHECKING:": "what annotations alone need is imported, too: time alone",
    "cli/verify.py AddNot 0: if TYPE_CHECKING: => if not TYPE_CHECKING:": "what annotations alone need is imported, too: time alone",
    "compensator/iwo.py ReplaceFalseWithTrue 0: self.search.tell(self._task.losses(self.search.ask().astype(self._dtype, copy=False))) => self.search.tell(self._task.losses(self.search.ask().astype(self._dtype, copy=True)))": "a copy of the same numbers: memory alone",
    "compensator/network.py NumberReplacer 10: z = np.matmul(first.reshape(-1, first.shape[-1]), inputs, out=buffers(0, (first[..., 0].size, samples), dtype)) => z = np.matmul(first.reshape(- 2, first.shape[-1]), inputs, out=buffers(0, (first[..., 0].size, samples), dtype))": "numpy takes any negative number for the dimension that is left",
    "compensator/trainers/levenberg_marquardt.py NumberReplacer 10: size = max(1, 4_000_000 // (task.layout.count * task.targets.size)) => size = max( 2, 4_000_000 // (task.layout.count * task.targets.size))": "how many problems are computed at once: memory alone",
    "core/linear_gaussian/columns.py ReplaceComparisonOperator_Gt_NotEq 2: return Combined((*blocks, *[(end, len(columns), None)] * (len(columns) > end))) => return Combined((*blocks, *[(end, len(columns), None)] * (len(columns) != end)))": "no part ends behind the last column",
    "diagnosis/laws/candidates.py NumberReplacer 135: ends = np.cumsum([8 * width * c.unit[..., 0].size * len(c.function.settings) for c in every]) => ends = np.cumsum([8 * width * c.unit[..., -1].size * len(c.function.settings) for c in every])": "every part of the last axis has one size",
    "effects/formula_effect.py RemoveDecorator 2:  => def drivers(self) -> tuple[str, ...]:": "each class that is made has a property of its own; this one says that it is missing",
    "effects/definition.py ReplaceBinaryOperator_Pow_Add 1: scale = np.array([np.abs(d).max(), np.abs(d).max() ** 3]) => scale = np.array([np.abs(d).max(), np.abs(d).max() + 3])": "the unit of a column in which least squares are solved: the same stiffnesses to 1e-9",
    "effects/formula.py ExceptionReplacer 4: except (ValueError, RecursionError, MemoryError, SyntaxWarning, DeprecationWarning): => except (ValueError, RecursionError, MemoryError, CosmicRayTestingException, DeprecationWarning):": "Python makes a SyntaxError of what its parser warns of; no text of the allowed letters and length ends here",
    "export/controller/programs/correction.py ReplaceFalseWithTrue 1: @dataclass(frozen=True, eq=False) => @dataclass(frozen=True, eq=True)": "nothing compares two of them",
    'export/mjcf/mjcf.py ReplaceTrueWithFalse 3: for axis, words, k in zip("xy", AXIS_VECTORS[:2], parts.base, strict=True): => for axis, words, k in zip("xy", AXIS_VECTORS[:2], parts.base, strict=False):': "a base has two springs, one for each axis",
    'fleet/evidence.py NumberReplacer 51: curve = [f"joint_error_curve.{w}{k}_q{j}" for k in range(1, MAX_COMPARED_HARMONIC + 1) for w in "sc"] => curve = [f"joint_error_curve.{w}{k}_q{j}" for k in range( 0, MAX_COMPARED_HARMONIC + 1) for w in "sc"]': "no curve has a harmonic of order zero: names that are no parameters are dropped",
    "fleet/touch_model.py NumberReplacer 63: grown = lengths[0] * self.warming => grown = lengths[ -1] * self.warming": "there is one candidate of this kind: the last is the first",
    "fleet/touches.py ReplaceTrueWithFalse 4: for n, v in zip(self.model.names, d * scale, strict=True) => for n, v in zip(self.model.names, d * scale, strict=False)": "there is one number for each name",
    "identification/arm_or_camera.py NumberReplacer 298: total = float(np.sqrt(((unit @ y[first].reshape(-1, 6)[:, :3, None]) ** 2).sum(axis=(1, 2)).mean())) => total = float(np.sqrt(((unit @ y[first].reshape(- 2, 6)[:, :3, None]) ** 2).sum(axis=(1, 2)).mean()))": "numpy takes any negative number for the dimension that is left",
    "identification/arm_or_camera.py NumberReplacer 104: for last in [False] * 8 + [True]:  # by then the estimates have converged => for last in [False] * 9 + [True]:  # by then the estimates have converged": "the iterations have converged: one more moves the log-likelihood, 1051 in a test, by 7e-6",
    "measurements/corners.py NumberReplacer 258: return frame(R, H[:, 2] - R @ [*middle, seen[0, 4]]) => return frame(R, H[:, 2] - R @ [*middle, seen[ 1, 4]])": "the corners of a board lie in the plane z = 0: others are refused",
    "pose_selection/design_problem.py ReplaceFalseWithTrue 2: weight: Array = field(repr=False) => weight: Array = field(repr=True)": "what is printed is a Selection, which has words of its own",
    "pose_selection/experimental_design.py NumberReplacer 4: flat = rows.reshape(-1, self.p) => flat = rows.reshape(- 2, self.p)": "numpy takes any negative number for the dimension that is left",
    "pose_selection/camera_stations.py ReplaceFalseWithTrue 0: @dataclass(frozen=True, eq=False) => @dataclass(frozen=True, eq=True)": "nothing compares two of them",
    "project/networks.py ReplaceTrueWithFalse 8: @dataclass(frozen=True, eq=False) => @dataclass(frozen=False, eq=False)": "frozen keeps from assigning; nothing assigns",
    'project/live/estimate.py ReplaceTrueWithFalse 2: np.sqrt(np.einsum("kip,pq,kiq->", J, self.covariance[:p, :p], J, optimize=True) / len(J)) => np.sqrt(np.einsum("kip,pq,kiq->", J, self.covariance[:p, :p], J, optimize=False) / len(J))': "the order in which the same products are added: time alone",
    "robot/urdf/tree.py ReplaceTrueWithFalse 0: arms = [e for e, way in zip(ends, beyond, strict=True) if not {j.name for j in way} <= led] => arms = [e for e, way in zip(ends, beyond, strict=False) if not {j.name for j in way} <= led]": "there is one way for each end",
    "robot/dynamics.py NumberReplacer 104: @lru_cache(maxsize=16) => @lru_cache(maxsize= 17)": "how many are held in memory: time alone",
    "robot/urdf/tree.py NumberReplacer 5: largest = max(map(abs, numbers), default=0.0) => largest = max(map(abs, numbers), default= -1.0)": "of no numbers, any size below the bounds is as good",
    "robot/robot_file.py ReplaceBinaryOperator_Sub_BitXor 0: gone = set(knowledge.std_errors) - set(robot.parameters.names) if knowledge else set[str]() => gone = set(knowledge.std_errors) ^ set(robot.parameters.names) if knowledge else set[str]()": "names that the knowledge does not have are taken from it, too: it stays as it is",
}
