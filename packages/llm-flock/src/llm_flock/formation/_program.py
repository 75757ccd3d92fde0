"""A formation program: what to draw, as data that a model writes in JSON and a person in TOML."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Annotated, Any, Literal, Self, TypeAlias, cast, get_args

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic.json_schema import SkipJsonSchema
from pydantic_core import PydanticKnownError

from llm_flock.bounds import MAX_PROGRAM_BYTES
from llm_flock.errors import InputError
from llm_flock.formation._letters import GLYPHS
from llm_flock.validation import checked

MAX_DEPTH = 8  #: Deepest nesting of unions.
DECIMALS = 6  #: Decimals of a program's numbers in its canonical text.
MARK = "program:"  #: What a mission's shape begins with if a program in JSON follows.

WIDEST = (-1e6, 1e6)  #: Limits of numbers.


def _rounded(value: float) -> float:
    """The number that the canonical text has."""
    return round(value, DECIMALS) + 0.0


def _factor(value: float) -> float:
    if not _rounded(value):
        raise PydanticKnownError("greater_than_equal", {"ge": 10.0**-DECIMALS})
    return _rounded(value)


Number = Annotated[float, Field(ge=WIDEST[0], le=WIDEST[1], allow_inf_nan=False, strict=True), AfterValidator(_rounded)]
Factor = Annotated[float, Field(gt=0, le=WIDEST[1], allow_inf_nan=False, strict=True), AfterValidator(_factor)]
Vector = Annotated[tuple[Number, ...], Field(min_length=2, max_length=3)]
Factors = Annotated[tuple[Factor, ...], Field(min_length=2, max_length=3)]
Letters = Annotated[
    str, BeforeValidator(lambda text: text.upper() if isinstance(text, str) else text), Field(max_length=40)
]
Name = Annotated[str, Field(max_length=40, pattern=r"^[\w .-]*$")]

Flat: TypeAlias = Literal["line", "circle", "triangle", "square", "polygon", "star", "cross", "wedge", "grid"]
Spatial: TypeAlias = Literal["sphere", "dome", "cylinder", "helix", "cube", "pyramid"]
SPACE: tuple[str, ...] = get_args(Spatial)  #: Figures in space; they are shapes of a mission, too.
KINDS = ("shape", "text", "path", "points", "union")


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True, use_attribute_docstrings=False)


class Repeat(_Table):
    """Copies, each moved, turned and scaled from the one before."""

    times: int = Field(ge=2, le=100, strict=True)
    move: Vector | None = None
    turn: Number = 0.0
    scale: Factor = 1.0


class Element(_Table):
    """Exactly one of shape, text, path, points, union; then scaled, mirrored, turned, tilted, moved, repeated."""

    shape: Literal[Flat, Spatial] | None = Field(default=None, description="of radius or half side 1 around [0, 0]")
    text: Letters | None = Field(default=None, description="letters, digits, - + / . : ! ?; 10 high")
    path: str | None = Field(default=None, description="SVG path data, y downwards")
    points: tuple[Vector, ...] | None = Field(default=None, min_length=1, description="corners, y upwards")
    union: tuple[Element, ...] | None = Field(default=None, min_length=1)
    closed: bool = Field(default=False, strict=True, description="points: back to the first one")
    fill: bool = Field(default=False, strict=True, description="robots inside, not along the outline")
    sides: int | None = Field(default=None, ge=3, le=100, strict=True, description="of a polygon")
    arc: tuple[Number, Number] | None = Field(default=None, description="circle: part from, to, in degrees")
    turns: Factor | None = Field(default=None, description="of a helix")
    scale: Factor | Factors = 1.0
    mirror: Literal["x", "y", "z"] | None = Field(default=None, description="coordinate that changes its sign")
    turn: Number = Field(default=0.0, description="degrees, anticlockwise")
    # As in `mission.Preference`: Python keeps one of two equal unions, in the order of the first one that is imported.
    point: Literal["west", "east", "north", "south"] | None = Field(
        default=None, description="where it points if it pointed north (+y)"
    )
    tilt: Number = Field(default=0.0, description="degrees about x; 90 stands upright in space")
    move: Vector | None = None
    repeat: Repeat | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        given = [kind for kind in KINDS if getattr(self, kind) is not None]
        if len(given) != 1:
            raise InputError("draw", given, f"exactly one of {', '.join(KINDS)} in an element")
        kind = given[0]
        goes: tuple[tuple[str, bool], ...] = (
            ("closed", kind == "points"),
            ("sides", self.shape == "polygon"),
            ("arc", self.shape == "circle"),
            ("turns", self.shape == "helix"),
            ("fill", kind != "text"),
        )
        for name, fits in goes:
            value = getattr(self, name)
            if value not in (None, False) and not fits:
                raise InputError(name, value, says=f"does not go with {kind} = {getattr(self, kind)!r}")
        if self.shape == "polygon" and self.sides is None:
            raise InputError("sides", None, "a number from 3 to 100 for a polygon")
        if self.arc is not None and not 0 < self.arc[1] - self.arc[0] <= 360:
            raise InputError("arc", list(self.arc), "from less than to, at most 360 degrees apart")
        if self.point is not None and self.turn:
            raise InputError("turn", self.turn, says="point or turn, not both")
        unknown = sorted(set(self.text or "") - GLYPHS.keys())
        if unknown or (self.text is not None and not self.text.strip()):
            raise InputError("text", self.text, f"one or more of {''.join(GLYPHS).strip()} and spaces")
        return self


class Group(_Table):
    """A part of the team with a role of its own."""

    role: Name
    count: int | None = Field(default=None, ge=1, strict=True, description="robots; or else a share of the others")
    share: Factor = 1.0
    at: Vector = Field(default=(0.0, 0.0), description="its centre, in units from the first group's at [0, 0]")
    size: SkipJsonSchema[Factor | None] = None
    """Largest width in units; follows from the robots if unset."""
    draw: tuple[Element, ...] = Field(min_length=1)


class Program(_Table):
    """Draws a formation: either what all robots draw, or groups. Robots are placed evenly, at the mission's spacing."""

    name: Name = ""
    draw: tuple[Element, ...] | None = Field(default=None, min_length=1)
    groups: tuple[Group, ...] | None = Field(default=None, min_length=1, max_length=20)
    size: Factor | None = Field(default=None, description="largest width in units; follows from the robots if unset")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.draw is None) == (self.groups is None):
            raise InputError("draw", None, says="either draw or groups is needed, not both")
        if self.groups is not None and self.size is not None:
            raise InputError("size", self.size, says="has no effect on groups, whose size follows from their robots")
        if (size := len(self.text.encode())) > MAX_PROGRAM_BYTES:
            raise InputError("program", None, f"at most {MAX_PROGRAM_BYTES:,} bytes in JSON (here {size:,})")
        return self

    @property
    def in_space(self) -> bool:
        """Whether it needs three dimensions."""
        groups = self.groups or ()
        return any(map(_in_space, self.draw or ())) or any(
            len(group.at) > 2 or any(map(_in_space, group.draw)) for group in groups
        )

    @property
    def text(self) -> str:
        """The canonical form: JSON without defaults and spaces, keys in order. Equal programs have equal texts."""
        return json.dumps(_plain(self.model_dump(exclude_defaults=True)), separators=(",", ":"), sort_keys=True)

    @property
    def spoken(self) -> str:
        """The same with spaces and in the order of the schema, as models write it."""
        return json.dumps(_plain(self.model_dump(exclude_defaults=True)), ensure_ascii=False)

    @property
    def digest(self) -> str:
        """16 hexadecimal digits that identify the canonical form."""
        return hashlib.blake2b(self.text.encode(), digest_size=8).hexdigest()

    @property
    def spec(self) -> str:
        """The program as a mission's `shape`."""
        return MARK + self.text


def _in_space(element: Element) -> bool:
    vectors = [element.move, element.repeat and element.repeat.move, *(element.points or ())]
    deep = element.shape in SPACE or bool(element.tilt) or any(len(vector or ()) > 2 for vector in vectors)
    return deep or any(map(_in_space, element.union or ()))


def _plain(value: Any) -> Any:
    """Whole numbers without a point, so that equal numbers are equal text."""
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in cast("Mapping[str, Any]", value).items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in cast("Iterable[Any]", value)]
    if isinstance(value, float):
        return int(value) if value.is_integer() else value
    return value


def parse_program(given: str | Mapping[str, Any], field: str = "program") -> Program:
    """A program from JSON text, or from a table that was read already.

    Raises:
        InputError: it is no program; names `field` with the place in it, the value and what is allowed.
    """
    if isinstance(given, str):
        if (size := len(given.encode(errors="replace"))) > MAX_PROGRAM_BYTES:
            raise InputError(field, None, f"at most {MAX_PROGRAM_BYTES:,} bytes of JSON (here {size:,})")
        try:
            given = json.loads(given)
        except (ValueError, RecursionError) as error:
            raise InputError(field, None, says=f"broken JSON: {error}") from None
    if not isinstance(given, Mapping):
        raise InputError(field, given, "an object with draw or groups")
    if _deeper(given, 3 * MAX_DEPTH):
        raise InputError(field, None, f"at most {MAX_DEPTH} unions inside each other")
    return checked(Program, dict(given), field)


def _deeper(value: Any, levels: int) -> bool:
    """Whether tables and lists are inside each other more often than this."""
    if isinstance(value, Mapping):
        value = list(cast("Mapping[str, Any]", value).values())
    parts = cast("list[Any]", value) if isinstance(value, list) else []
    return bool(parts) and (levels <= 0 or any(_deeper(part, levels - 1) for part in parts))


@lru_cache(maxsize=256)
def program_of(spec: str) -> Program | None:
    """The program that a mission's shape stands for: `letters:HELLO`, `program:{...}`, `sphere`; None for others.

    Raises:
        InputError: what follows the colon is no program, or no letters.
    """
    name, _, argument = spec.partition(":")
    if name == "program":
        if not argument.lstrip().startswith("{"):
            raise InputError("shape", spec, "a program in JSON; a configuration or flag reads program:FILE, too")
        return parse_program(argument, "shape")
    if name == "letters":
        return parse_program({"draw": [{"text": argument}]}, "shape")
    return parse_program({"draw": [{"shape": spec}]}, "shape") if spec in SPACE else None


def program_schema() -> dict[str, Any]:
    """The JSON schema of a program, for a model: without titles, defaults, the widest limits, and null."""

    def lean(part: Any) -> Any:
        if isinstance(part, list):
            return [lean(one) for one in cast("list[Any]", part)]
        if not isinstance(part, dict):
            return part
        table = {k: lean(v) for k, v in cast("dict[str, Any]", part).items() if k != "default" and v not in WIDEST}
        if isinstance(table.get("title"), str):
            del table["title"]
        options = [one for one in table.pop("anyOf", []) if one != {"type": "null"}]
        return table | (options[0] if len(options) == 1 else {"anyOf": options} if options else {})

    return lean(Program.model_json_schema())
