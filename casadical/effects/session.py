"""Base and tool, and where wanted the joints' zeros, of a later session of the same campaign, against the first one."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import casadi as ca

from casadical.core.arm import Arm
from casadical.core.transforms import Symbolic, small_frame, translate
from casadical.effects.base import Context, Effect, setting


@dataclass(frozen=True)
class Session(Effect):
    """which : its name in the column `session`; base, tool : whether it has its own; zeros : of so many first joints"""

    which: str = setting("", given=True)
    base_too: bool = setting(True, given=True)
    tool_too: bool = setting(True, given=True)
    zeros: int = setting(0, given=True)

    name = "session"
    on_list = "unknown"
    of_measurement = True
    held = 1.0
    signature = "another session: instrument, foot and target were set up again"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return ()

    @property
    def label(self) -> str:
        return f"{self.name}_{self.which}"

    @property
    def column(self) -> str:
        """The condition that is 1 in this session, else 0."""
        return f"session_{self.which}"

    @property
    def conditions(self) -> tuple[str, ...]:
        return (self.column,)

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        base = dict.fromkeys(("x", "y", "z"), (1.0, "m")) | dict.fromkeys(("rx", "ry", "rz"), (0.5, "rad"))
        tool = {f"tool_{c}": (0.05, "m") for c in "xyz"}
        zeros = {f"zero{i}": (1e-3, "rad") for i in range(1, self.zeros + 1)}
        return (base if self.base_too else {}) | (tool if self.tool_too else {}) | zeros

    def _now(self, context: Context, name: str) -> Symbolic:
        return self.value(context, name) * context.conditions[self.column]

    def joint_angle(self, context: Context) -> Symbolic:
        moved = ca.SX.zeros(context.arm.n)
        for i in range(self.zeros):
            moved[i] = self._now(context, f"zero{i + 1}")
        return moved

    def base(self, context: Context) -> Symbolic:
        if not self.base_too:
            return ca.SX.eye(4)
        return small_frame(*(self._now(context, name) for name in ("x", "y", "z", "rx", "ry", "rz")))

    def tool(self, context: Context) -> Symbolic:
        return translate(*(self._now(context, f"tool_{c}") for c in "xyz")) if self.tool_too else ca.SX.eye(4)
