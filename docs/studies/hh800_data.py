"""Make data/hh800_twin/hh800_twin.csv, the twin of the paper's experiment: python docs/studies/hh800_data.py"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))  # for the simulator in numpy

from numpy_physics import hh800_twin

if __name__ == "__main__":
    path = Path(__file__).parents[2] / "data" / "hh800_twin" / "hh800_twin.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    hh800_twin().to_csv(path, index=False)
    print(f"wrote {path.relative_to(Path.cwd())}")
