"""The manifest of an export folder as it is read again, every entry checked."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from casadical.core.basics import InputError
from casadical.core.reading import read_bytes
from casadical.export.c.coefficients import Real
from casadical.export.c.language import NAME


class Facts(BaseModel):
    """What a manifest says of the compiled functions."""

    model_config = ConfigDict(strict=True, extra="ignore", frozen=True)

    name: str = Field(pattern=NAME)
    real: Real
    joints: int = Field(ge=1, le=100)
    units: list[Literal["rad", "m"]] = []
    outputs: dict[Literal["network", "curves", "forward", "correct"], Annotated[int, Field(ge=1, le=100)]]

    @model_validator(mode="after")
    def _of_each_joint(self) -> Self:
        if self.units and len(self.units) != self.joints:
            raise ValueError(f"{len(self.units)} units of {self.joints} joints")
        return self


class Manifest(BaseModel):
    """manifest.json of an export, as far as it is read again."""

    model_config = ConfigDict(strict=True, extra="ignore", frozen=True, allow_inf_nan=False)

    kernel: Facts
    files: dict[str, str]
    figures: dict[str, float] = {}


def read_manifest(export: Path) -> Manifest:
    """The manifest of an export folder. Raises InputError."""
    path = export / "manifest.json"
    if not path.is_file():
        raise InputError(f"{export} has no manifest.json; give a folder that `casadical export c` wrote")
    try:
        return Manifest.model_validate_json(read_bytes(path))
    except ValidationError as error:
        fault = error.errors()[0]
        place = ".".join(map(str, fault["loc"])) or "the file"
        raise InputError(f"{path} is damaged ({place}: {fault['msg']}); export again") from None
