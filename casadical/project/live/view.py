"""What a live session tells, made of its plain data: blocks, and sentences that its page shows as they are."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from casadical.core.telling.blocks import Table, Words
from casadical.core.telling.result import Result
from casadical.project.live.estimate import FEWEST

# A share of readings of which 95 % lie below is stated from so many on.
FOR_QUANTILE = 20


@dataclass(frozen=True, eq=False)
class LiveView(Result):
    """Readings, what is known of the robot by now, and the next pose.

    data : of `casadical measure --json` without its sentences, angles [deg], lengths [mm]
    """

    kept_as: ClassVar[str] = "live"
    data: Mapping[str, Any]

    def to_json(self) -> dict[str, Any]:
        known = self.data["known"]
        return {
            **self.data,
            "about": self.about,
            "readings": [{**r, "words": self.words(r)} for r in self.data["readings"]],
            "known": known and {**known, "figures": _figures(known)},
            "known_words": _known_words(known),
        }

    def blocks(self) -> list[Words | Table]:
        known = self.data["known"]
        blocks: list[Words | Table] = [Words(f"{self.about}.", "verdict"), Words(f"{_known_words(known)}.")]
        blocks += [Table("", ("known by now", ""), _figures(known), frozenset({1}))] if known else []
        blocks += [Words(self.answer(r["number"]), "warning") for r in self.data["readings"] if r["state"] != "good"]
        return [*blocks, *(Words(text, "warning") for text in self.data["table"])]

    @property
    def about(self) -> str:
        """Which campaign it is, and how many of its readings count."""
        good = sum(r["state"] == "good" for r in self.data["readings"])
        origin = "measured" if self.data["data"] == "real" else "SYNTHETIC"
        return f"{self.data['folder']}, {origin}: {good} of {len(self.data['readings'])} readings count"

    def words(self, reading: Mapping[str, Any]) -> str:
        """What there is to say of a reading besides its state."""
        return "; ".join(text for text in (_off(reading), reading["why"], self._soon(reading)) if text)

    def _soon(self, reading: Mapping[str, Any]) -> str:
        return "" if self.data["known"] or reading["state"] != "good" else f"judged from reading {FEWEST + 1} on"

    def answer(self, number: int) -> str:
        """What a reading told, in a line or two."""
        reading = next(r for r in self.data["readings"] if r["number"] == number)
        left = self.data["known"] and self.data["known"]["left_out_mean_mm"]
        judged = reading["state"] in ("good", "doubtful") and left is not None
        state = {"good": "plausible", "doubtful": "DOUBTFUL"}.get(reading["state"], reading["state"])
        text = f"{number}: {state}" + (f" ({off})" if (off := _off(reading)) else "")
        text += "" if state == "plausible" else f": {reading['why']}"
        means = f"{left:.3f} mm mean of readings left out one by one" if judged else ""
        return "; ".join(part for part in (text, self._soon(reading), means) if part)

    def outlook(self) -> list[str]:
        """What is wrong with the whole table, and the next pose, in lines."""
        lines, ahead = [*self.data["table"]], self.data["next"]
        if ahead is not None:
            pairs = zip(self.data["fields"], ahead["poses"][0], strict=False)  # first the joints
            touch = f"  touching {ahead['touch']}" if ahead["touch"] else ""
            lines += [ahead["words"], "next: " + "  ".join(f"{name} {value:.3f}" for name, value in pairs) + touch]
            lines += [ahead["program"]] * bool(ahead["program"])
        return lines


def _off(reading: Mapping[str, Any]) -> str:
    return "" if reading["off_mm"] is None else f"{reading['off_mm']:.3f} mm off what the others predict"


def _known_words(known: Mapping[str, Any] | None) -> str:
    if known is None:
        return f"{FEWEST} readings are needed"
    text = f"{known['readings']} readings tell of the robot; they scatter by {known['noise_mm']:.3f} mm a coordinate"
    return f"{text}; a promise from {FOR_QUANTILE} on" if known["promise_mm"] is None else text


def _figures(known: Mapping[str, float | None]) -> list[tuple[str, str]]:
    named = {
        "mean, left out one by one": known["left_out_mean_mm"],
        "95 % below, to promise": known["promise_mm"],
        "robot, whole ranges": known["expected_mm"],
    }
    return [(name, "\u2013" if v is None else f"{v:.{3 if v < 10 else 0}f} mm") for name, v in named.items()]
