"""The three robots of the campaigns, as built."""

import json
from pathlib import Path

from casadical.simulation import Plant, perturb

ROBOTS = ("hh800", "kr210", "ur10e")
FOLDER = Path(__file__).parents[2] / "data" / "campaigns" / "robots"


def nominal(name: str) -> Plant:
    return Plant.from_dict(json.loads((FOLDER / f"{name}.json").read_text()))


def built(name: str, seed: int = 5) -> Plant:
    return perturb(nominal(name), seed)
