"""The sentences and tables of a live session, from its plain data (angles [deg], lengths [mm])."""

from collections.abc import Mapping
from typing import Any

from casadical.core.reporting.blocks import Table, Words
from casadical.project.live.estimate import MIN_READINGS_OF_FIT

# Minimum number of readings with which the 95 % quantile of their errors is stated.
MIN_READINGS_FOR_QUANTILE = 20


def with_words(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return a session's data with sentences added, as `casadical measure --json` stores it.

    data : as `LiveSession.state` assembles it. Added keys are about, known_words, `words` of each
        reading, and `figures` of the estimate.
    """
    figures = data["known"]
    good = sum(r["state"] == "good" for r in data["readings"])
    origin = "measured" if data["data"] == "real" else "SYNTHETIC"
    readings = []
    for reading in data["readings"]:
        soon = (
            f"judged from reading {MIN_READINGS_OF_FIT + 1} on"
            if figures is None and reading["state"] == "good"
            else ""
        )
        readings.append({**reading, "words": "; ".join(filter(None, (_off(reading), reading["why"], soon)))})
    known_words = f"{MIN_READINGS_OF_FIT} readings are needed"
    if figures is not None:
        known_words = (
            f"{figures['readings']} readings tell of the robot; they scatter by {figures['noise_mm']:.3f} mm a "
        )
        known_words += "coordinate" + (
            f"; a promise from {MIN_READINGS_FOR_QUANTILE} on" if figures["promise_mm"] is None else ""
        )
    return {
        **data,
        "about": f"{data['folder']}, {origin}: {good} of {len(readings)} readings count",
        "readings": readings,
        "known": figures and {**figures, "figures": _figures(figures)},
        "known_words": known_words,
    }


def summary(state: Mapping[str, Any]) -> list[Words | Table]:
    """Return a session's last blocks, on its `state`: estimate, readings that are not good."""
    figures = state["known"]
    blocks: list[Words | Table] = [Words(f"{state['about']}.", "verdict"), Words(f"{state['known_words']}.")]
    blocks += [Table("", ("known by now", ""), figures["figures"], frozenset({1}))] if figures else []
    blocks += [Words(answer(state, r["number"]), "warning") for r in state["readings"] if r["state"] != "good"]
    return [*blocks, *(Words(text, "warning") for text in state["table"])]


def answer(state: Mapping[str, Any], number: int) -> str:
    """Return the judgement of reading `number` as text; state : as of `LiveSession.state`."""
    reading = next(r for r in state["readings"] if r["number"] == number)
    usual = state["known"] and state["known"]["left_out_mean_mm"]
    words = {"good": "plausible", "doubtful": "DOUBTFUL"}.get(reading["state"], reading["state"])
    text = f"{number}: {words}"
    if off := _off(reading):
        text += f" ({off})"
    if words != "plausible":
        text += f": {reading['why']}"
    elif state["known"] is None:
        text += f"; judged from reading {MIN_READINGS_OF_FIT + 1} on"
    if reading["state"] in ("good", "doubtful") and usual is not None:
        text += f"; {usual:.3f} mm mean of readings left out one by one"
    return text


def outlook(state: Mapping[str, Any]) -> list[str]:
    """Return lines on faults of the table and the next pose; state : as of `LiveSession.state`."""
    lines, ahead = [*state["table"]], state["next"]
    if ahead is not None:
        pairs = zip(state["fields"], ahead["poses"][0], strict=False)  # first the joints
        lines += [ahead["words"], "next: " + "  ".join(f"{name} {value:.3f}" for name, value in pairs)]
        lines += [ahead["program"]] * bool(ahead["program"])
    return lines


def _off(reading: Mapping[str, Any]) -> str:
    """Return a reading's distance from its prediction as text [mm]; empty where it is unknown."""
    return "" if reading["off_mm"] is None else f"{reading['off_mm']:.3f} mm off what the others predict"


def _figures(estimate: Mapping[str, float | None]) -> list[tuple[str, str]]:
    """Return (name, value) of errors in key `known` as texts [mm]; a dash for an unknown one."""
    named = {
        "mean, left out one by one": estimate["left_out_mean_mm"],
        "95 % below, to promise": estimate["promise_mm"],
        "robot, whole ranges": estimate["expected_mm"],
    }
    return [(name, "\u2013" if v is None else f"{v:.{3 if v < 10 else 0}f} mm") for name, v in named.items()]
