"""Reads and validates the project's TOML formats, turning every mistake into one line: file, key, value, expected."""

from __future__ import annotations

import tomllib
from difflib import get_close_matches
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from bms_ukf.errors import ConfigError


class Section(BaseModel):
    """A table of a TOML format: unknown keys, NaN, infinity and numbers written as text are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)
    replaced: ClassVar[dict[str, str]] = {}  # keys of earlier versions, and what stands in their place


class Document(Section):
    """A whole file; `format` is the version of its layout."""

    format: Literal[1]


M = TypeVar("M", bound=BaseModel)


def load(path: Path, model: type[M]) -> M:
    """The file at `path` as `model`. Raises ConfigError naming the first mistake."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(path, expected=f"a readable TOML file ({error})") from None
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(path, expected=f"TOML ({error})") from None
    return validate(data, model, path)


def validate(data: dict[str, Any], model: type[M], source: str | Path) -> M:
    """`data` as `model`. Raises ConfigError naming the first mistake and how many more there are."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        # A misspelt key shows up twice, as an unknown key and as a missing one: the unknown one says more.
        mistakes = sorted(error.errors(), key=lambda mistake: mistake["type"] != "extra_forbidden")
        first = mistakes[0]
        key = ".".join(str(part) for part in first["loc"])
        expected = _expected(dict(first), model)
        if len(mistakes) > 1:
            expected += f" (and {len(mistakes) - 1} more)"
        value = None if isinstance(first["input"], dict | list) else first["input"]
        if first["type"] == "union_tag_invalid":
            key, value = f"{key}.kind", first["ctx"]["tag"]
        raise ConfigError(source, key=key or None, value=value, expected=expected) from None


def _expected(mistake: dict[str, Any], model: type[BaseModel]) -> str:
    if mistake["type"] == "extra_forbidden":
        tables = _tables_at(model, mistake["loc"][:-1])
        for table in tables:
            if new := getattr(table, "replaced", {}).get(mistake["loc"][-1]):
                return f"no such key: {new}"
        known = _keys_of(tables)
        near = get_close_matches(str(mistake["loc"][-1]), known, n=1)
        return f"no such key (did you mean {near[0]}?)" if near else f"no such key (known: {', '.join(known)})"
    if mistake["type"] == "union_tag_invalid":
        known = [tag.strip("' ") for tag in mistake["ctx"]["expected_tags"].split(",")]
        near = get_close_matches(mistake["ctx"]["tag"], known, n=1)
        return f"one of {', '.join(known)}" + (f" (did you mean {near[0]}?)" if near else "")
    if mistake["type"] == "missing":
        return "this key, which is missing"
    text = str(mistake["msg"]).removeprefix("Value error, ").removeprefix("Input should be ")
    return text


def _tables_at(model: type[BaseModel], location: tuple[int | str, ...]) -> list[type[BaseModel]]:
    """The tables that may stand at a location, whose parts are keys, indices and the `kind` of one of several."""
    tables = [model]
    for part in map(str, location):
        of_kind = [table for table in tables if part in get_args(_annotation(table, "kind"))]
        inside = [nested for table in tables for nested in _models(_annotation(table, part))]
        tables = of_kind or inside or tables
    return tables


def _keys_of(tables: list[type[BaseModel]]) -> list[str]:
    return list(dict.fromkeys(field.alias or name for table in tables for name, field in table.model_fields.items()))


def _annotation(model: type[BaseModel], name: str) -> Any:
    field = model.model_fields.get(name)
    return None if field is None else field.annotation


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]
