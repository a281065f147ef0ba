"""Results as JSON: which kinds there are, what each begins with, and what strict JSON has no numbers for."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, TypeAlias

Record: TypeAlias = dict[str, Any]

#: What one file is about: a command, or one of the ways to use it.
Kind: TypeAlias = Literal[
    "validate", "check", "checks", "compare", "truth", "certify", "explain", "stability", "fuzz", "failure", "speed",
    "renderers",
]  # fmt: skip

#: The schema that all of them keep to, validation/results.schema.json, and its version: another one where a field goes
#: or means something else; fields may come.
SCHEMA = "urn:whitted:results:1"


def result(kind: Kind, fields: Mapping[str, Any]) -> Record:
    """A result as strictly valid JSON, which says what it is."""
    head: Record = {"schema": SCHEMA, "kind": kind}
    strict: Record = json_value(head | dict(fields) | head)  # one may be made of another
    return strict


def json_value(value: Any) -> Any:
    """The same value with infinities and NaN as strings, which is what strict JSON leaves for them."""
    if isinstance(value, Mapping):
        return {key: json_value(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [json_value(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
    return value


def text(record: Mapping[str, Any]) -> str:
    """As it is written."""
    return json.dumps(record, indent=1, allow_nan=False) + "\n"


def write(path: Path, record: Mapping[str, Any]) -> None:
    """Beside its place, then renamed: whole or not there."""
    from tracer.passes import write_beside

    with write_beside(path) as temporary:
        temporary.write_text(text(record), encoding="utf-8")
