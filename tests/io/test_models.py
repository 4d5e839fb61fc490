"""Settings of files and arguments are converted as documented, or refused with the key at fault."""

import enum
import pickle
from pathlib import Path
from typing import Annotated, Literal

import pytest

from homeward.io.checks import AfterValidator, Field, ValidationError, kind_of
from homeward.io.models import Strict, jsonable, model_validator


class Side(enum.Enum):
    LEFT = "left"


class Circle(Strict):
    kind: Literal["circle"] = "circle"
    radius: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class Line(Strict):
    kind: Literal["line"] = "line"
    ends: tuple[float, float] = (0.0, 1.0)


class Plan(Strict):
    name: Annotated[str, Field(min_length=1, pattern="^[a-z]+$")] = "plan"
    shape: Annotated[Circle | Line, Field(discriminator="kind")] = Line()
    tags: dict[str, list[int]] = {}
    file: Path | None = None

    @model_validator(mode="after")
    def _no_empty_tag(self):
        if not all(self.tags.values()):
            raise ValueError("a tag needs numbers")
        return self


def problem(make):
    with pytest.raises(ValidationError) as caught:
        make()
    return str(caught.value)


@pytest.mark.parametrize(
    ("kind", "given", "converted"),
    [
        (float, "0.5", 0.5),
        (float, 2, 2.0),
        (int, "3.0", 3),
        (int, 3.0, 3),
        (bool, "off", False),
        (bool, 1, True),
        (Path, "a/b", Path("a/b")),
        (Side, "left", Side.LEFT),
        (Literal["a", 1], 1, 1),
        (float | None, None, None),
        (int | float, 2.5, 2.5),
        (str | float, "2", "2"),
        (tuple[float, ...], ["1", 2], (1.0, 2.0)),
        (tuple[int, str], [1, "a"], (1, "a")),
        (dict[str, float], {"a": "1"}, {"a": 1.0}),
        (Annotated[float, AfterValidator(lambda v: v * 2)], "3", 6.0),
    ],
)
def test_a_value_of_a_file_is_converted(kind, given, converted):
    found = kind_of(kind).check(given, False)
    assert (found, type(found)) == (converted, type(converted))


@pytest.mark.parametrize(
    ("kind", "given", "words"),
    [
        (float, True, "must be a number"),
        (float, "1,5", "must be a number"),
        (float, None, "must be a number"),
        (float, 10**400, "must be a number"),
        (int, 2.5, "must be a whole number"),
        (int, float("inf"), "must be a whole number"),
        (int, True, "must be a whole number"),
        (bool, "maybe", "must be true or false"),
        (str, 5, "must be text"),
        (str, "\ud800", "must be text"),
        (Side, [], "must be left"),
        (Literal["a", "b"], "c", "must be a or b"),
        (Literal[1], True, "must be 1"),
        (list[int], "12", "must be a list"),
        (list[int], [1, "x"], "1: must be a whole number"),
        (tuple[float, float], [1.0], "1: is required"),
        (tuple[float, float], [1.0, 2.0, 3.0], "takes at most 2 values"),
        (dict[str, int], [1], "must be keys and values"),
        (Annotated[float, Field(ge=0.0, lt=1.0)], 1.0, "must be less than 1"),
        (Annotated[float, Field(ge=0.0)], float("nan"), "must be at least 0"),
        (Annotated[float, Field(allow_inf_nan=False)], float("nan"), "must be finite"),
        (Annotated[list[int], Field(max_length=1)], [1, 2], "takes at most 1 values"),
    ],
)
def test_a_wrong_value_is_refused_in_words(kind, given, words):
    assert problem(lambda: kind_of(kind).check(given, False)) == words


@pytest.mark.parametrize(("kind", "given"), [(float, "1"), (int, 1.0), (bool, 1), (bool, "true")])
def test_a_strict_value_is_not_converted(kind, given):
    kind_of(kind).check(given, False)
    problem(lambda: kind_of(kind).check(given, True))


def test_all_problems_of_a_model_are_named_with_their_keys():
    given = {"name": "", "shape": {"kind": "circle", "radius": 0}, "tags": {"a": ["x"]}, "size": 1}
    words = problem(lambda: Plan.model_validate(given)).split("; ")
    assert words == [
        "name: needs at least 1 characters",
        "shape.radius: must be greater than 0",
        "tags.a.0: must be a whole number",
        "size: unknown key",
    ]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"shape": {"kind": "square"}}, "shape: kind must be one of circle, line, not square"),
        ({"shape": {"radius": 1.0}}, "shape: needs the key kind"),
        ({"shape": {"kind": "circle"}}, "shape.radius: is required"),
        ({"shape": 3}, "shape: must be keys and values"),
        ({"name": "Plan"}, "name: must match ^[a-z]+$"),
        ({"tags": {"a": []}}, "a tag needs numbers"),
        ({"from": "x"}, "from: unknown key"),
        ([], "must be keys and values"),
    ],
)
def test_a_model_is_refused_with_the_key_at_fault(given, words):
    assert problem(lambda: Plan.model_validate(given)) == words


def test_a_model_is_written_as_it_is_read():
    plan = Plan.model_validate({"shape": {"kind": "circle", "radius": "2"}, "file": "a.csv"})
    written = plan.model_dump(mode="json")
    assert written["file"] == "a.csv"
    assert written["shape"] == {"kind": "circle", "radius": 2.0}
    assert Plan.model_validate(written) == plan
    assert hash(plan.shape) == hash(Circle(radius=2.0))
    assert plan.model_dump(exclude_unset=True) == {
        "shape": plan.shape.model_dump(),
        "file": Path("a.csv"),
    }
    assert Line(ends=(float("nan"), 1.0)).model_dump_json() == '{"kind":"line","ends":[null,1.0]}'
    assert jsonable({Side.LEFT: (Path("a"), Line())}) == {
        "left": ["a", Line().model_dump(mode="json")]
    }


def test_a_model_cannot_be_changed_and_defaults_are_not_shared():
    plan, other = Plan(), Plan()
    with pytest.raises(AttributeError, match="use model_copy"):
        plan.name = "b"
    assert (plan.model_copy(update={"name": "b"}).name, plan.name) == ("b", "plan")
    plan.tags["a"] = [1]
    assert other.tags == {}
    assert plan.model_fields_set == set()


def test_problems_survive_a_worker_process():
    with pytest.raises(ValidationError) as caught:
        Circle(radius=-1)
    assert str(pickle.loads(pickle.dumps(caught.value))) == "radius: must be greater than 0"
