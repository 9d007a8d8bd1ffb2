"""An error layer by layer: on held-out poses, from the calibrated robot to the noise, each cause beside those above."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

from casadical.diagnosis.result import Diagnosis

COLUMNS = ("layer", "mean", "95 %", "time left out", "without noise")


@dataclass(frozen=True)
class Layer:
    """One layer; errors in mm on poses held out, None where there is none of it.

    name : what is taken off with it, beside all layers above
    mean_mm, low_mm, high_mm : mean error with a 95 % interval over poses; blocks_mm : with fifths of the time left out
    model_mm : rms with the noise's own taken off
    """

    name: str
    mean_mm: float
    low_mm: float | None = None
    high_mm: float | None = None
    blocks_mm: float | None = None
    model_mm: float | None = None


def layers(d: Diagnosis) -> tuple[Layer, ...]:
    """The layers in the order in which they were found; () where no cause has effects to take off.

    The last one is what noise alone leaves in the same fit: that of repeated poses, or as the fit has it.
    """
    return tuple(_layers(d)) if d.effects() else ()


def _layers(d: Diagnosis) -> Iterator[Layer]:
    whole = any(c.effect == "outliers" for c in d.causes)
    if whole:
        yield Layer("as calibrated, outliers in", 1e3 * d.gap.before)
    for k, row in enumerate(d.course.to_dict("records")):
        first = "outliers left out" if whole else "as calibrated"
        figures = (float(row[name]) for name in ("gap_mm", "low_mm", "high_mm", "blocks_mm", "model_mm"))
        yield Layer(str(row["model"]) if k else first, *figures)
    r = d.replicates
    yield Layer(f"noise of {r.poses} repeated poses" if r.enough else "noise as the fit has it", 1e3 * d.gap.floor)


def layer_rows(d: Diagnosis) -> list[tuple[str, ...]]:
    """Rows of text under `COLUMNS`."""
    return [
        (
            a.name,
            f"{a.mean_mm:.3f}",
            "" if a.low_mm is None else f"{a.low_mm:.3f} to {a.high_mm:.3f}",
            "" if a.blocks_mm is None else f"{a.blocks_mm:.3f}",
            "" if a.model_mm is None else f"{a.model_mm:.3f}",
        )
        for a in layers(d)
    ]


def as_json(d: Diagnosis) -> list[dict[str, Any]]:
    """The layers as plain data, what is not known left out."""
    return [
        {k: round(v, 5) if isinstance(v, float) else v for k, v in asdict(a).items() if v is not None}
        for a in layers(d)
    ]
