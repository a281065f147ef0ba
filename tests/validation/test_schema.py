"""The published schema of result files: files keep to it, it has every field, and the document explains every field."""

from __future__ import annotations

import copy
import json
import re
import sys
from importlib import resources
from pathlib import Path
from typing import Any, get_args

import doubles
import numpy as np
import pytest
from command_line import NATIVE, one_pixel
from conftest import strict
from doubles import Double, with_arrays
from jsonschema import Draft202012Validator, ValidationError

from validation import records

SCHEMA = json.loads(resources.files("validation").joinpath("results.schema.json").read_text(encoding="utf-8"))
SCENES = Path(__file__).resolve().parents[2] / "scenes"
DOCUMENT = (Path(__file__).resolve().parents[2] / "docs" / "results.md").read_text(encoding="utf-8")


def closed(schema: Any) -> Any:
    """The same, but a field that it does not know is wrong."""
    if isinstance(schema, list):
        return [closed(entry) for entry in schema]
    if not isinstance(schema, dict):
        return schema
    found = {key: closed(entry) for key, entry in schema.items()}
    # The whole says which kind there is, the kind which fields.
    whole = "$defs" in schema or "required" not in schema
    return found if whole or not isinstance(schema.get("properties"), dict) else found | {"additionalProperties": False}


STRICT = Draft202012Validator(closed(SCHEMA))


def properties(schema: Any) -> set[str]:
    if isinstance(schema, list):
        return set().union(*map(properties, schema))
    if not isinstance(schema, dict):
        return set()
    named = schema.get("properties", {})
    return {*named}.union(*map(properties, schema.values()))


def holes(arrays: doubles.Arrays) -> None:
    one_pixel(arrays)
    arrays["depth"][3, 3] = np.nan
    arrays["ambient"][20, 30] = np.inf


@pytest.fixture
def record(run: Any, scene: Path, tmp_path: Path, registered: Any) -> Any:
    """What `validate` finds of renderers that agree, differ, lack a pass and fail."""
    registered(
        Double(draw=with_arrays(holes)),
        Double(name="poor", missing=("normal",)),
        Double(name="odd", draw=lambda *_: None),
    )
    file = tmp_path / "results.json"
    run("validate", scene, "--renderer", "double,poor,odd,native-f32", "--against", "native-f64", "--json", file)
    return strict(file.read_text())


def test_the_schema_is_one() -> None:
    Draft202012Validator.check_schema(SCHEMA)


def test_validate_keeps_to_it(record: Any, run: Any, scene: Path, tmp_path: Path) -> None:
    STRICT.validate(record)
    assert record["verdicts"]
    assert record["failures"]
    assert run("validate", scene, *NATIVE, "--json", tmp_path / "right.json").status == 0
    STRICT.validate(strict((tmp_path / "right.json").read_text()))


def test_what_is_wrong_is_found(record: Any) -> None:
    """It is the schema that says so, and not one that lets all pass."""

    def refused(change: Any) -> None:
        other = copy.deepcopy(record)
        change(other)
        with pytest.raises(ValidationError):
            STRICT.validate(other)

    refused(lambda other: other.pop("unfinished"))
    refused(lambda other: other["comparisons"][0].update(max="large"))
    refused(lambda other: other["comparisons"][0].update(new=1))
    refused(lambda other: other["verdicts"][0]["groups"][0].update(cause="whim"))
    refused(lambda other: other["verdicts"][0]["groups"][0]["pixels"].append([1]))
    refused(lambda other: other["settings"].update(sample="middle"))
    refused(lambda other: other["notes"].append({"scene": "a"}))


def test_a_field_more_is_no_fault_for_readers(record: Any) -> None:
    Draft202012Validator(SCHEMA).validate(record | {"of a later version": 1})


def test_check_and_compare_keep_to_it(run: Any, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=":")
    assert run("render", scene, "-o", "mine.ppm", "--max-reflections", 0).status == 0
    assert run("check", scene, "--image", "mine.ppm", "--json", "check.json").status == 1
    programs = ("--command", "raytrace {scene}", "--command", "false {scene}")
    assert run("check", scene, *programs, "--json", "checks.json").status == 3
    for name in ("a", "b"):
        assert (
            run("render", scene, "-o", f"{name}.npz", "--renderer", f"n{'ative' if name == 'a' else 'umpy'}-f64").status
            == 0
        )
    assert run("compare", "a.npz", "b.npz", "--json", "compare.json").status == 1
    for name in ("check", "checks", "compare"):
        STRICT.validate(strict(Path(f"{name}.json").read_text()))
    with pytest.raises(ValidationError):
        STRICT.validate(strict(Path("check.json").read_text()) | {"left": None})


def test_truth_keeps_to_it(run: Any, scene: Path, tmp_path: Path, registered: Any) -> None:
    file = tmp_path / "truth.json"
    tie = SCENES / "spec" / "equal-hits.txt"
    assert run("truth", scene, tie, "--pixels", 20, "--json", file).status == 0
    STRICT.validate(strict(file.read_text()))
    assert run("truth", tie, "--at", 72, 200, "--json", file).status == 0
    proved = strict(file.read_text())
    STRICT.validate(proved)
    assert proved["scenes"][0]["pixels"][0]["ties"]
    registered(Double(draw=with_arrays(holes)))
    words = ("--pixels", "all", "--edges", 5, "--size", "16x12", "--json", file)
    run("truth", scene, "--renderer", "native-f32", *words)
    STRICT.validate(strict(file.read_text()))
    registered(Double(draw=with_arrays(lambda arrays: arrays["beauty"].fill(0.5)), missing=("normal",)))
    assert run("truth", scene, "--renderer", "double", *words).status == 1
    wrong = strict(file.read_text())
    STRICT.validate(wrong)
    assert wrong["certificates"][0]["misses"]
    wrong["certificates"][0]["misses"][0].pop("claim")
    with pytest.raises(ValidationError):
        STRICT.validate(wrong)


def test_explain_and_renderers_keep_to_it(run: Any, scene: Path, tmp_path: Path, registered: Any) -> None:
    file = tmp_path / "explained.json"
    registered(Double(draw=with_arrays(lambda arrays: arrays["beauty"].fill(0.5)), missing=("normal",)))
    sides = ("--renderer", "double,native-f32")
    tie = ((SCENES / "spec" / "equal-hits.txt", 72, 200), (SCENES / "spec" / "mirror-corridor.txt", 180, 205))
    for pixel in ((scene, 20, 20), *tie):
        assert run("explain", *pixel, *sides, "--json", file).status == 0
        record = strict(file.read_text())
        STRICT.validate(record)
        assert (record["schema"], record["kind"]) == (SCHEMA["$id"], "explain")
        assert record["command"][:2] == ["whitted", "explain"]
        assert {"whitted", "compiler"} <= record["versions"].keys()
    assert record["renderers"][0]["differences"]
    listed = run("renderers", "--json")
    STRICT.validate(strict(listed.out))


def test_stability_keeps_to_it(run: Any, tmp_path: Path, registered: Any) -> None:
    file = tmp_path / "stability.json"
    registered(Double(draw=with_arrays(lambda arrays: arrays["beauty"].fill(0.5)), missing=("normal",)))
    climb = ("stability", "--ladder", "speck", "--jobs", 1, "--json", file)
    assert run(*climb, "--renderer", "native-f32", "--write", tmp_path / "rungs").status == 0
    STRICT.validate(strict(file.read_text()))
    assert run(*climb, "--renderer", "cmd:false {scene}").status == 3
    failed = strict(file.read_text())
    STRICT.validate(failed)
    assert failed["ladders"][0]["rungs"][0]["steps"]["cmd:false {scene}"]["failed"]
    failed["ladders"][0]["rungs"][0]["steps"]["cmd:false {scene}"].pop("refused")
    with pytest.raises(ValidationError):
        STRICT.validate(failed)


def test_fuzz_keeps_to_it(run: Any, tmp_path: Path) -> None:
    file, kept = tmp_path / "fuzz.json", tmp_path / "kept"
    words = ("stability", "--fuzz", 1, "--seed", 6, "--jobs", 1, "-o", kept, "--json", file)
    assert run(*words, "--renderer", "numpy-f64").status == 0
    STRICT.validate(strict(file.read_text()))
    assert run(*words, "--renderer", "cmd:false {scene}").status == 3
    found = strict(file.read_text())
    STRICT.validate(found)
    assert found["kinds"][0]["what"] == "failed"
    (beside,) = kept.glob("*.json")
    failure = strict(beside.read_text())
    assert failure["kind"] == "failure"
    STRICT.validate(failure)


def test_speed_keeps_to_it(run: Any, scene: Path, tmp_path: Path) -> None:
    file = tmp_path / "speed.json"
    words = ("--size", "16x12", "--seconds", 0.01, "--rounds", 3, "--pixels", 4, "--json", file)
    assert run("speed", scene, "--renderer", "native-f32@scalar", *words, "--edges", 0).status == 0
    record = strict(file.read_text())
    STRICT.validate(record)
    assert record["scenes"][0]["entries"][0]["errors"]["edge_max"] is None
    record["scenes"][0]["entries"][0].pop("cold")
    with pytest.raises(ValidationError):
        STRICT.validate(record)


def test_every_kind_says_what_it_is() -> None:
    kinds = SCHEMA["properties"]["kind"]["enum"]
    assert tuple(kinds) == get_args(records.Kind)
    assert SCHEMA["$id"] == records.SCHEMA
    for kind in kinds:
        head = SCHEMA["$defs"][kind]["properties"]
        assert (head["schema"]["const"], head["kind"]["const"]) == (records.SCHEMA, kind)
    with pytest.raises(ValidationError):
        STRICT.validate({"schema": records.SCHEMA, "kind": "poem"})


def test_the_document_explains_every_field() -> None:
    told = set(re.findall(r"`(\w+)`", DOCUMENT))
    assert properties(SCHEMA) - told == set()
