"""Copies of settings and results with some fields replaced."""

from __future__ import annotations

from typing import Any, TypeVar

from pydantic import BaseModel

from ._suggestions import did_you_mean

Model = TypeVar("Model", bound=BaseModel)


def replaced(model: Model, **values: Any) -> Model:
    """The model with these fields replaced; TypeError for a field that it does not have.

    ``model_copy(update=...)`` takes any name in silence: what a renamed setting was set to is lost. Values are not
    validated, as there.
    """
    fields = type(model).model_fields
    for name in values:
        if name not in fields:
            raise TypeError(f"{type(model).__name__} has no field '{name}'{did_you_mean(name, fields)}")
    return model.model_copy(update=values)
