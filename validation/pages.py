"""Pages and other texts that people read: how they are made of templates, and how they are written."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jinja2 import Environment


def environment() -> Environment:
    """Templates of `validation/report`."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader("validation.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def write_text(path: Path, text: str) -> None:
    """Beside its place, then renamed: whole or not there.

    The name of a file may have bytes that are no UTF-8, which Python keeps as what UTF-8 cannot hold.
    """
    from tracer.passes import write_beside

    with write_beside(path) as temporary:
        temporary.write_text(re.sub("[\ud800-\udfff]", "\ufffd", text), encoding="utf-8")
