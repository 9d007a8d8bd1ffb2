"""Compensators as files: versioned JSON with full precision and a sha256; no pickles."""

import os
from dataclasses import asdict
from typing import Any

import numpy as np

from casadical.compensator.checksummed_json import checksummed, read_checksummed, write_checksummed
from casadical.compensator.compensator import Compensator
from casadical.compensator.layout import JointBox, Layout
from casadical.compensator.network import Network
from casadical.compensator.report import BeforeAfter, Errors
from casadical.core.errors import InputError

KIND, VERSION = "casadical-compensator", 1


def save_compensator(compensator: Compensator, path: str | os.PathLike[str]) -> None:
    """Write a compensator to a JSON file; an older file is replaced in one piece."""
    write_checksummed(path, KIND, VERSION, _body(compensator))


def compensator_text(compensator: Compensator) -> str:
    """Return the text that `save_compensator` writes, for those who write several files together."""
    return checksummed(KIND, VERSION, _body(compensator))


def _body(compensator: Compensator) -> dict[str, Any]:
    net = compensator.network
    network = None
    if net is not None:
        network = {"box_rad": asdict(net.box), "output_scale_mm": net.output_scale_mm, "weights": net.weights.tolist()}
    body = {name: getattr(compensator, name) for name in _PLAIN}
    body |= {name: asdict(getattr(compensator, name)) for name in ("layout", "training", "choice")}
    body["validation"] = None if compensator.validation is None else asdict(compensator.validation)
    body |= {"trained_box_rad": asdict(compensator.trained_box), "network": network, "verdict": compensator.verdict}
    return body


def load_compensator(path: str | os.PathLike[str]) -> Compensator:
    """Read a compensator that `save_compensator` wrote.

    Raises InputError when the file is missing, truncated, changed, of another kind or version, or inconsistent.
    """
    body = read_checksummed(path, KIND, VERSION)
    try:
        return _compensator(body)
    except InputError as error:
        raise InputError(f"{path} does not hold a usable compensator: {error}") from None
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path} lacks a field of a compensator, or has a wrong one: {error!r}") from None


_PLAIN = ("chosen_by", "margin", "trainer", "settings", "note", "seed", "data_sha256")


def _compensator(body: dict[str, Any]) -> Compensator:
    layout = Layout(**body["layout"])
    net = body["network"]
    network = None
    if net is not None:
        network = Network(layout, _box(net["box_rad"]), np.array(net["weights"]), float(net["output_scale_mm"]))
    return Compensator(
        network=network,
        layout=layout,
        trained_box=_box(body["trained_box_rad"]),
        training=_before_after(body["training"]),
        choice=_before_after(body["choice"]),
        validation=None if body["validation"] is None else _before_after(body["validation"]),
        **{name: body[name] for name in _PLAIN},
    )


def _box(value: dict[str, Any]) -> JointBox:
    return JointBox(tuple(value["lower"]), tuple(value["upper"]))


def _before_after(value: dict[str, Any]) -> BeforeAfter:
    return BeforeAfter(Errors(**value["before"]), Errors(**value["after"]), value["gain"], value["gain_error"])
