"""A small robot and a network in SX, made for these tests: the exporter must not need the package's own kinematics."""

import casadi as ca
import numpy as np

from casadical.export.c.products import Command, NetworkFunction

LOWER = np.deg2rad([-170.0, -60.0, -60.0, -180.0, -110.0, -180.0])
UPPER = np.deg2rad([170.0, 75.0, 70.0, 180.0, 110.0, 180.0])

# Modified DH rows (alpha, a, d, theta0) in rad and m, like a 2.5 m heavy-duty arm.
NOMINAL = np.array(
    [
        [0.0, 0.0, 0.0, 0.0],
        [np.pi / 2, 0.515, 0.0, 0.0],
        [0.0, 1.6, 0.0, 0.0],
        [np.pi / 2, 0.35, 1.9, 0.0],
        [-np.pi / 2, 0.0, 0.0, 0.0],
        [np.pi / 2, 0.0, 0.445, 0.0],
    ]
)
TOOL = np.array([-0.45, 0.11, 0.93])
MASS = [1400.0, 520.0, 780.0, 260.0, 130.0, 360.0]
COM = [[0.25, 0, -0.3], [0.75, 0, 0.1], [0.12, 0.25, 0], [0, 0, -0.55], [0, 0.05, 0], [-0.2, 0.05, 0.4]]
COMPLIANCE = 1e-6 * np.array([0.13, 0.15, 0.2, 0.8, 1.0, 1.5])  # rad per N m


def link(row, beta, theta, p):
    """A point of frame i in frame i-1: modified DH with a turn beta about y for parallel axes."""
    c, s = ca.cos(theta), ca.sin(theta)
    x, y, z = c * p[0] - s * p[1], s * p[0] + c * p[1], p[2] + row[2]
    if beta:
        x, z = np.cos(beta) * x + np.sin(beta) * z, np.cos(beta) * z - np.sin(beta) * x
    ca_, sa = np.cos(row[0]), np.sin(row[0])
    return ca.vertcat(x + row[1], ca_ * y - sa * z, sa * y + ca_ * z)


def point(q, rows, betas, p, last=6):
    for i in reversed(range(last)):
        p = link(rows[i], betas[i], q[i] + rows[i][3], p)
    return p


def calibrated_rows(seed=0, millimetre=1e-3, angle=2e-3):
    """About 30 values off their nominal ones, joint offsets the largest: some 30 mm at the tool."""
    rng = np.random.default_rng(seed)
    rows = NOMINAL + rng.normal(size=NOMINAL.shape) * [angle, millimetre, millimetre, 4 * angle]
    return rows, [0.0, 0.0, float(rng.normal() * angle), 0.0, 0.0, 0.0]


def network_dp(q, seed=0, hidden=5, form="tansig"):
    """A 6-hidden-3 network in millimetres."""
    rng = np.random.default_rng(seed)
    w1, b1 = rng.normal(size=(hidden, 6)), rng.normal(size=hidden)
    w2, b2 = 0.5 * rng.normal(size=(3, hidden)), 0.1 * rng.normal(size=3)
    a = ca.mtimes(w1, (q - (LOWER + UPPER) / 2) * (2 / (UPPER - LOWER))) + b1
    shapes = {"tansig": 2 / (1 + ca.exp(-2 * a)) - 1, "tanh": ca.tanh(a), "one_minus": 1 - 2 / (ca.exp(2 * a) + 1)}
    return ca.mtimes(w2, shapes[form]) + b2


def network(seed=0, hidden=5, form="tansig"):
    q = ca.SX.sym("q", 6)
    return ca.Function("network", [q], [network_dp(q, seed, hidden, form)], ["q"], ["dp_mm"])


def nominal():
    q = ca.SX.sym("q", 6)
    return ca.Function("nominal", [q], [point(q, NOMINAL, [0.0] * 6, ca.SX(TOOL))], ["q"], ["p"])


def deflection(q):
    """Joint deflections under gravity: compliance times the torques of the nominal arm."""
    height = sum(MASS[i] * point(q, NOMINAL, [0.0] * 6, ca.SX(COM[i]), i + 1)[2] for i in range(6))
    return -9.81 * COMPLIANCE * ca.gradient(height, q)


def kinematics(seed=0, compliance=True):
    q = ca.SX.sym("q", 6)
    rows, betas = calibrated_rows(seed)
    bent = q + deflection(q) if compliance else q
    return ca.Function("kinematics", [q], [point(bent, rows, betas, ca.SX(TOOL))], ["q"], ["p"])


def calibrated(seed=0, with_network=True):
    q = ca.SX.sym("q", 6)
    p = kinematics(seed)(q)
    return ca.Function("calibrated", [q], [p + 1e-3 * network_dp(q, seed) if with_network else p], ["q"], ["p"])


def bent():
    q = ca.SX.sym("q", 6)
    return ca.Function("bent", [q], [q + deflection(q)], ["q"], ["bent"])


def four_bar(q, lengths=(0.5, 0.9, 0.55, 1.0)):
    """Angle of the rocker of a four-bar loop driven by q: crank, coupler, rocker, ground [m]."""
    crank, coupler, rocker, ground = lengths
    x, y = ground - crank * ca.cos(q), -crank * ca.sin(q)
    diagonal = ca.sqrt(x**2 + y**2)
    inner = ca.acos((rocker**2 + diagonal**2 - coupler**2) / (2 * rocker * diagonal))
    return ca.atan2(y, x) + inner


def with_loop(seed=0, lengths=(0.5, 0.9, 0.55, 1.0)):
    """The calibrated chain with joint 3 driven through a four-bar loop."""
    q = ca.SX.sym("q", 6)
    turned = ca.vertcat(q[0], q[1], q[2] + 0.02 * (four_bar(q[2] + 1.5, lengths) - 1.5), q[3:])
    return ca.Function("with_loop", [q], [kinematics(seed)(turned)], ["q"], ["p"])


def pose_of(rows, betas):
    """Position and rotation of the tool, by three more points of the last frame."""
    q = ca.SX.sym("q", 6)
    p = point(q, rows, betas, ca.SX(TOOL))
    axes = [point(q, rows, betas, ca.SX(TOOL + np.eye(3)[k])) - p for k in range(3)]
    return ca.Function("pose", [q], [p, ca.horzcat(*axes)], ["q"], ["p", "R"])


def network_function():
    return NetworkFunction(network(), LOWER, UPPER)


def command(network):
    """The correction of the bent arm, with a network."""
    of, at = kinematics(compliance=False), bent()
    return Command(nominal(), calibrated(), LOWER, UPPER, jacobian_of=of, jacobian_at=at, network=network)
