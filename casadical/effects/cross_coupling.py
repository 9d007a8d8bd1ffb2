"""A joint is deflected by the torque of another one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class CrossCoupling(Effect):
    """source : the joint (1-based) whose torque moves this one."""

    source: int = 1

    name: ClassVar[str] = "cross_coupling"
    physics: ClassVar[str] = (
        "The stiffness matrix has terms off its diagonal: with a parallelogram, bending of the upper arm turns joint "
        "3 by joint 2's torque, or the other way round (Klimchik et al. 2013)."
    )
    confused_with: ClassVar[str] = "link_flexure; tell by payloads at two offsets"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {f"k{self.source}": (60e-6, "rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:  # noqa: ARG002 - moved by the other joint's torque
        return self.value(context, f"k{self.source}") * context.load(self.source)
