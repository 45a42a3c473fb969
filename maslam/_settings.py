"""The root of all settings: immutable, no unknown key, and no number that nobody can mean."""

from __future__ import annotations

from typing import Any, get_args

from pydantic import BaseModel, ConfigDict, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

_SMALLEST, _LARGEST = 1e-6, 1e9
"""As shares of a default. A setting has limits of its own where they are narrower."""
_LEAST, _BOUNDLESS = 1e-9, 1e15
_FINE = ("_threshold", "tolerance")
"""Ends of names of numbers at which an iteration ends: as small as wanted."""
"""For numbers whose default is zero or nothing."""


class Settings(BaseModel):
    """Numbers are finite. Where a setting has a positive default, a positive value is at least a millionth of it, or of
    one where that is less, and at most a thousand million times it: what is beyond (1e-12 metres, 1e30 key-frames) ends
    in a number that no computer holds, or in a run that never ends."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _no_boolean_number(cls, value: Any, info: ValidationInfo) -> Any:
        """YAML takes yes, no, on and off for true and false, and pydantic true for 1."""
        if isinstance(value, bool) and info.field_name is not None:
            meant = cls.model_fields[info.field_name].annotation
            kinds = {meant, *get_args(meant)}
            if kinds & {int, float} and bool not in kinds:
                raise PydanticCustomError("no_number", "A number is meant, not true or false (yes and no are these)")
        return value

    @field_validator("*")
    @classmethod
    def _within_reason(cls, value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, bool) or not isinstance(value, int | float) or info.field_name is None or not value:
            return value
        default = cls.model_fields[info.field_name].default
        usual = float(default) if isinstance(default, int | float) and not isinstance(default, bool) else 0.0
        if "seed" in info.field_name:
            return value
        least = min(usual, 1.0) * _SMALLEST if usual > 0 else _LEAST
        if 0 < abs(value) < least and not info.field_name.endswith(_FINE):
            raise PydanticCustomError("too_small", f"0 or at least {least:g} is meant; {default} is usual")
        most = max(usual, 1.0) * _LARGEST if usual > 0 else _BOUNDLESS
        if abs(value) > most:
            raise PydanticCustomError("too_large", f"At most {most:g} is meant; {default} is usual")
        return value
