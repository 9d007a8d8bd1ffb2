"""mujoco.sysid: parameters are modifiers of an MjSpec, least squares by finite differences of a residual function.

It has no static measurements: its residuals compare sensors over simulated time. The residual below is one of our own
(one forward kinematics a pose, `mj_kinematics`), the parameters, the modifiers and the optimiser are the package's. It
chooses no parameters: the 27 are told, as to the hand-made ones: the modified Denavit-Hartenberg rows of the inner
axes, beta at the parallel ones, the base's six and the tool's three.
"""

import mujoco
import numpy as np
from mujoco import sysid
from problem import N_IDENTIFIABLE, NOMINAL_DH, PARALLEL_ROWS, Data, frames_start, rigid

NEEDS = {"mujoco": "mujoco", "absl": "absl-py"}
VARIANTS = {"mujoco.sysid": {}}
LENGTH, ANGLE = 0.05, 0.1  # half the width of the box that the optimiser asks for [m], [rad]
AT_BASE = 3.0  # the same for base and tool, whose start is found
UNIT = np.ones(3)


def _row(alpha, a, beta, theta, d):
    x, y, z = np.eye(3)
    zero = np.zeros(3)
    return rigid(alpha * x, a * x) @ rigid(beta * y, zero) @ rigid(theta * z, d * z)


def _put(body, T):
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(T[:3, :3]).ravel())
    body.pos, body.quat = T[:3, 3], quat


def _spec():
    """Six bodies with a hinge each, the measured point a site on the last one."""
    spec = mujoco.MjSpec()
    parent = spec.worldbody
    for k in range(6):
        parent = parent.add_body(name=f"link{k}", mass=1.0, inertia=UNIT, explicitinertial=True)
        parent.add_joint(name=f"q{k}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
    parent.add_site(name="tool")
    return spec


def _parameters(base, tool):
    """The 27 as a vector of each body, with the modifier that puts it there."""
    found = sysid.ParameterDict()

    def add(name, start, width, modifier):
        start = np.asarray(start, dtype=float)
        found.add(sysid.Parameter(name, start, start - width, start + width, modifier=modifier))

    def base_at(spec, parameter):
        _put(
            spec.body("link0"), rigid(parameter.value[3:], np.zeros(3)) @ base @ rigid(np.zeros(3), parameter.value[:3])
        )

    add("base", np.zeros(6), AT_BASE, base_at)
    for k in range(1, 6):
        alpha, a, theta, d = NOMINAL_DH[k]
        inner = k < 5

        def at(spec, parameter, k=k, alpha=alpha, a=a, theta=theta, d=d, inner=inner):
            v = np.append(parameter.value, np.zeros(4 - parameter.size))
            if k in PARALLEL_ROWS:  # alpha, a, beta, theta
                row = _row(alpha + v[0], a + v[1], v[2], theta + v[3], d)
            else:
                row = _row(alpha + v[0], a + v[1], 0.0, theta + v[2] * inner, d + v[3] * inner)
            _put(spec.body(f"link{k}"), row)

        count = 4 if inner else 2
        width = np.array([ANGLE, LENGTH, ANGLE, ANGLE] if k in PARALLEL_ROWS else [ANGLE, LENGTH, ANGLE, LENGTH])
        add(f"row{k}", np.zeros(count), width[:count], at)
    add("tool", tool, AT_BASE, lambda spec, parameter: setattr(spec.site("tool"), "pos", parameter.value))
    return found


def _positions(params, spec, q):
    model = sysid.apply_param_modifiers(params, spec)
    data, p = mujoco.MjData(model), np.empty((len(q), 3))
    for k, readings in enumerate(q):
        data.qpos[:] = readings
        mujoco.mj_kinematics(model, data)
        p[k] = data.site_xpos[0]
    return p


def contend(data: Data, clock):
    """Predicted positions (m, 3) [m] of the held-out poses."""
    with clock("build"):
        spec = _spec()
    with clock("solve"):
        R_base, t_base, tool = frames_start(data)
        base = np.eye(4)
        base[:3, :3], base[:3, 3] = R_base, t_base + R_base @ [0, 0, NOMINAL_DH[0, 3]]
        params = _parameters(base, tool)

        def residual(x, params):
            columns = []
            for column in np.atleast_2d(x.T):
                params.update_from_vector(column)
                columns.append(1e3 * (_positions(params, spec, data.q) - data.p).ravel())
            return [np.array(columns).T if x.ndim > 1 else columns[0]], [], []

        found, _ = sysid.optimize(params, residual, optimizer="mujoco", verbose=False)
    assert params.size == N_IDENTIFIABLE
    clock.note("parameters", params.size)
    return _positions(found, spec, data.q_held_out)
