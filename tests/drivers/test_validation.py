"""What a model refuses is one sentence that names every key, its value and what is allowed."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from drivers.validation import describe_first_problem, describe_problems, list_problems


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    rate: float = Field(gt=0, allow_inf_nan=False)
    name: str = "fetch"


class Settings(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    count: int = Field(ge=1)
    section: Section
    other: Section | None = None
    ends: tuple[int, ...] = ()

    @model_validator(mode="after")
    def _validate_ends(self) -> Settings:
        if sum(self.ends) == 13:
            raise ValueError("the ends\n add up to 13")
        return self


GOOD: dict[str, Any] = {"count": 1, "section": {"rate": 1.0}}
BAD_VALUES = {
    "count": st.integers(max_value=0) | st.text() | st.none() | st.floats(),
    "section.rate": st.floats(max_value=0) | st.just(float("nan")) | st.text() | st.none(),
    "section.name": st.integers() | st.none() | st.lists(st.integers()),
    "section": st.integers() | st.text() | st.lists(st.integers()),
    "other.rate": st.floats(max_value=0),
    "other": st.integers() | st.text(),
}


def explain(values: object) -> tuple[str, str]:
    with pytest.raises(ValidationError) as raised:
        Settings.model_validate(values)
    return (
        describe_problems(raised.value, Settings, "setting"),
        describe_first_problem(raised.value),
    )


def changed(changes: dict[str, Any]) -> dict[str, Any]:
    values: dict[str, Any] = {"count": 1, "section": {"rate": 1.0}}
    for key, value in sorted(changes.items()):
        section, _, name = key.rpartition(".")
        place = values if not section else values.setdefault(section, {})
        if isinstance(place, dict):
            place[name] = value
    return values


@given(data=st.data(), keys=st.sets(st.sampled_from(sorted(BAD_VALUES)), min_size=1))
def test_every_bad_value_is_named_once(data: st.DataObject, keys: set[str]) -> None:
    keys -= {f"{key}.{name}" for key in keys for name in ("rate", "name")}  # not in a section
    changes = {key: data.draw(BAD_VALUES[key]) for key in keys}
    sentence, first = explain(changed(changes))
    for key, value in changes.items():
        assert sentence.count(f"setting {key} is {value!r}") == 1
    with pytest.raises(ValidationError) as raised:
        Settings.model_validate(changed(changes))
    assert {problem.key for problem in list_problems(raised.value)} == keys
    assert any(first.startswith(f"{key}: ") for key in changes)
    for said in (sentence, first):
        assert "pydantic" not in said
        assert not said.endswith(".")


@given(name=st.text(min_size=1).filter(lambda name: name not in Settings.model_fields))
def test_an_unknown_key_is_told_from_valid_ones(name: str) -> None:
    sentence, _ = explain(GOOD | {name: 1})
    assert sentence.startswith(f"unknown setting {name!r}, valid: count, ends, other, section")
    sentence, _ = explain(GOOD | {"other": {"rate": 1.0, name + "x": 1}})
    assert f"unknown setting {'other.' + name + 'x'!r}, valid: other.name, other.rate" in sentence


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"section": {"rate": 1.0}}, "setting count is missing"),
        ({"count": 1, "section": {}}, "setting section.rate is missing"),
        (GOOD | {"other": 3}, "setting other is 3, allowed: a section with the keys rate, name"),
        (GOOD | {"count": 0}, "setting count is 0: input should be greater than or equal to 1"),
        (GOOD | {"ends": (1, "b")}, "setting ends.1 is 'b': input should be a valid integer"),
        (GOOD | {"ends": (6, 7)}, "the ends add up to 13"),
        (
            {"count": 0, "section": {"rat": 1.0}},
            (
                "setting count is 0: input should be greater than or equal to 1; "
                "setting section.rate is missing; "
                "unknown setting 'section.rat', valid: section.name, section.rate; "
                "did you mean 'section.rate'?"
            ),
        ),
    ],
)
def test_sentences(values: dict[str, Any], sentence: str) -> None:
    assert explain(values)[0] == sentence


def test_the_first_problem_has_its_key_before_it() -> None:
    assert explain({"count": 1, "section": {}})[1] == "section.rate: Field required"
    assert explain(GOOD | {"ends": (6, 7)})[1] == "the ends add up to 13"


def test_a_problem_keeps_path_kind_and_value() -> None:
    with pytest.raises(ValidationError) as raised:
        Settings.model_validate(GOOD | {"ends": (1, "b")})
    (problem,) = list_problems(raised.value)
    assert (problem.path, problem.kind, problem.value) == (("ends", "1"), "int_type", "b")
    assert problem.key == "ends.1"
