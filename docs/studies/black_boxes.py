"""python docs/studies/black_boxes.py > docs/studies/black_boxes.txt (needs scikit-learn beside the package)

The diagnosed robot beside black boxes, on a real UR10: held-out mean error [mm] of four layers and three learners.

Of its series C 30, 100 and 300 poses, drawn by three seeds, are learnt from; up to 2500 others judge, the same for all.
A learner predicts, from sines and cosines of the joint angles, what the model with geometry and compliance leaves in
each coordinate: a Gaussian process with a length scale for each input and noise, both by marginal likelihood; gradient
boosted trees and a multilayer perceptron, each with the best of its settings by five-fold cross-validation. They learn
from the poses that the calibration does not call outliers. `casadical` is the robot that `diagnose` writes, with every
cause that it names. File and splits are those of `joint_curves.py`.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
from sklearn.ensemble import GradientBoostingRegressor
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.model_selection import GridSearchCV
from sklearn.multioutput import MultiOutputRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

sys.path.insert(0, str(Path(__file__).parent))
from joint_curves import ROOT, SERIES, split
from real_diagnoses import campaign

from casadical import Measurements, diagnose, identify, read_problem
from casadical.identification.accuracy import errors, predicted

SIZES, SEEDS = (30, 100, 300), 3


def inputs(m: Measurements) -> np.ndarray:
    """Return sines and cosines of the joint angles, shape (n, 2 joints)."""
    return np.hstack([np.sin(m.q), np.cos(m.q)])


def learners(n_inputs: int) -> dict[str, object]:
    """Return each learner by its name; targets are in mm."""
    kernel = ConstantKernel(0.01) * RBF(np.ones(n_inputs), (1e-1, 1e3)) + WhiteKernel(0.01, (1e-6, 1e1))
    trees = {"estimator__n_estimators": [50, 200], "estimator__max_depth": [2, 4]}
    network = {"mlpregressor__hidden_layer_sizes": [(16,), (64,)], "mlpregressor__alpha": [1e-2, 1.0, 10.0]}
    return {
        "GP": MultiOutputRegressor(GaussianProcessRegressor(kernel, normalize_y=True, random_state=0)),
        "boosted trees": GridSearchCV(
            MultiOutputRegressor(GradientBoostingRegressor(learning_rate=0.05, subsample=0.7, random_state=0)), trees
        ),
        "MLP": GridSearchCV(
            make_pipeline(StandardScaler(), MLPRegressor(solver="lbfgs", max_iter=500, random_state=0)), network
        ),
    }


def means(robot: object, learn: Measurements, test: Measurements) -> dict[str, float]:
    """Return the mean held-out error of each layer and learner [mm]."""
    geometry = identify(robot, learn, method="KM", loss="huber").robot
    found = diagnose(robot, learn)
    base = found.identification.robot
    figures = {"geometry": errors(geometry, test), "+ compliance": errors(base, test)}
    used = learn[~np.isin(learn.row, [o.row for o in found.outliers])]
    remaining, on_test = (1e3 * (m.position - predicted(base, m)[0]) for m in (used, test))
    for name, learner in learners(2 * learn.q.shape[1]).items():
        guess = learner.fit(inputs(used), remaining).predict(inputs(test))  # type: ignore[attr-defined]
        figures[f"+ {name}"] = 1e-3 * np.linalg.norm(on_test - guess, axis=1)
    figures["casadical"] = errors(found.apply(), test)
    return {name: float(1e3 * each.mean()) for name, each in figures.items()}


if __name__ == "__main__":
    warnings.filterwarnings("ignore")  # of learners that stop at their limits
    print(f"real data; held-out mean error [mm], mean of {SEEDS} splits", flush=True)
    robot = read_problem(ROOT / "problems" / SERIES["C"]).robot
    m = campaign(SERIES["C"], robot)
    for size in SIZES:
        splits = (split(m, size, seed) for seed in range(SEEDS))
        rows = [means(robot, learn, test) for learn, test in splits]
        if size == SIZES[0]:
            print(f"{'series, poses learnt':<22}" + "".join(f"{key:>16}" for key in rows[0]))
        line = "".join(f"{np.mean([row[key] for row in rows]):16.3f}" for key in rows[0])
        print(f"{f'UR10 C, {size}':<22}{line}", flush=True)
