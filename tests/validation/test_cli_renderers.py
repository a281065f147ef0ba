"""`whitted renderers`: who can run here, and who delivers which pass."""

from __future__ import annotations

from typing import Any

from conftest import strict
from doubles import Double


def test_renderers_lists_them(run: Any, registered: Any) -> None:
    registered(Double(name="absent", absent="run: pip install absent"), failures={"third": "party: ImportError: gone"})
    result = run("renderers")
    assert result.status == 0
    lines = {line.split()[0]: line for line in result.out.splitlines()}
    for name in ("native-f64", "native-f32", "numpy-f64", "numpy-f32"):
        assert " yes " in lines[name]
        assert "shadow.L*, reflection, reflection.*" in lines[name]
    assert "no" in lines["absent"].split()
    assert "pip install absent" in lines["absent"]
    assert "entry point 'third' could not be loaded: party: ImportError: gone" in result.err


def test_renderers_as_json(run: Any, registered: Any) -> None:
    registered(Double(name="absent", absent="run: pip install absent"))
    record = strict(run("renderers", "--json").out)
    entries = {entry["name"]: entry for entry in record["renderers"]}
    assert entries["native-f64"]["available"] is True
    assert "reflection.*" in entries["native-f64"]["passes"]
    assert entries["absent"] == {
        "name": "absent",
        "available": False,
        "reason": "run: pip install absent",
        "version": None,
        "precision": None,
        "passes": [],
        "sources": {},
    }
    assert entries["numpy-f32"]["precision"] == "float32"
    assert entries["native-f64"]["sources"]["beauty"] == {"how": "stock", "always": True}


def test_who_delivers_which_pass(run: Any, registered: Any) -> None:
    class Some(Double):
        precision = "8-bit"

        def passes(self, scene: Any, settings: Any) -> tuple[str, ...]:
            del settings
            return ("id", "beauty") if scene.spheres[0].ks == 0 else ("id",)

        def sources(self, *_: Any) -> dict[str, str]:
            return {"id": "plugin", "beauty": "derived"}

    registered(Some(name="some"))
    every = run("renderers", "--passes").out.splitlines()
    head = next(place for place, line in enumerate(every) if line.startswith("pass ") and "some" in line)
    at, lines = every[head].index("some"), every[head : every.index("", head)]
    column = {line.split()[0]: line[at:].split("  ")[0].strip() for line in lines if line}
    assert column["id"] == "plugin"
    assert column["beauty"] == "derived *"
    assert column["depth"] == "-"
    assert column["precision"] == "8-bit"
    assert column["here"] == "yes"
    assert sum(line.startswith("pass ") for line in every) > 1, "as many side by side as there is room for"
    assert max(map(len, every)) <= 160
