"""python docs/studies/black_boxes.py > docs/studies/black_boxes.txt (needs scikit-learn beside the package)

The diagnosed robot beside black boxes, on real arms: held-out mean error [mm] of four layers and three learners.

Of each series 30, 100 and 300 poses, drawn by three seeds, are learnt from; up to 2500 others judge, the same for all.
A learner predicts, from sines and cosines of the joint angles, what the model with geometry and compliance leaves in
each coordinate: a Gaussian process with a length scale for each input and noise, both by marginal likelihood; gradient
boosted trees and a multilayer perceptron, each with the best of its settings by five-fold cross-validation. They learn
from the poses that the calibration does not call outliers. `casadical` is the robot that `diagnose` writes, with every
cause that it names. Files, splits and blunders that do not judge are those of `joint_curves.py`.
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
from joint_curves import ROOT, SERIES, judged, split
from real_diagnoses import campaign

from casadical import Measurements, diagnose, identify, read_problem
from casadical.identification.accuracy import errors, predicted
from casadical.measurements.derived_columns import derive

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
    arms = {f"UR10 {name}": (name, folder, None) for name, folder in SERIES.items()}
    arms["UR5 grid"] = ("UR5", "ur5", read_problem(ROOT / "problems" / "ur5").sets["identify"][0])
    headed = False
    for title, (name, folder, table) in arms.items():
        robot = read_problem(ROOT / "problems" / folder).robot
        approaches = [f"approach{i}" for i in range(1, robot.n + 1)]
        m = campaign(folder, robot) if table is None else derive(table, ["progress", *approaches])[0]
        for size in SIZES:
            rows = []
            for seed in range(SEEDS):
                learn, test = split(m, size, seed)
                rows.append(means(robot, learn, judged(name, test)))
            if not headed:
                print(f"{'series, poses learnt':<22}" + "".join(f"{key:>16}" for key in rows[0]))
                headed = True
            line = "".join(f"{np.mean([row[key] for row in rows]):16.3f}" for key in rows[0])
            print(f"{title + ', ' + str(size):<22}{line}", flush=True)
