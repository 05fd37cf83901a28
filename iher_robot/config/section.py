"""Typed sections of an experiment manifest."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from iher_robot.config.keys import Keys
from iher_robot.config.layers import Layer
from iher_robot.errors import UserError


class Section(BaseModel):
    """Base of every section: frozen, and an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


Model = TypeVar("Model", bound=Section)


def parse_section(model: type[Model], values: object, origin: str) -> Model:
    """Parse a section and check its keys and values.

    Args:
        model: Type of the section.
        values: Content of the YAML.
        origin: Origin for messages.

    Raises:
        UserError: The content is no mapping, a key does not exist or is missing, or a value is
            not allowed.
    """
    if not isinstance(values, Mapping):
        raise UserError(f"{origin}: expected lines of 'key: value', not {values!r}")
    keys = Keys(model)
    layer = Layer(origin, values)
    given = keys.flatten(layer)
    for key, field in keys.leaves.items():
        if field.is_required() and key not in given:
            raise UserError(f"{origin}: {key} is missing: {field.description}")
    try:
        # Through JSON, for its strict mode: a list is a tuple, but true is no number.
        text = json.dumps(keys.nest(given), default=str)
        return model.model_validate_json(text, strict=True)
    except ValidationError as error:
        raise UserError("; ".join(keys.explain(error, dict.fromkeys(given, layer)))) from None
