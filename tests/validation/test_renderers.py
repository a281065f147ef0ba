"""The registry of renderers: what it finds, what it forgives, and which variant a name means."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable, Iterator
from typing import Any

import doubles
import pytest
from doubles import Double

from tracer.passes import names
from validation import Settings, renderers
from validation.renderers import Renderer, Uncertainty
from validation.renderers.floats import UNIT_ROUNDOFF
from validation.renderers.native import Native
from validation.renderers.numpy import Reference

MADE: dict[str, Callable[[], Any]] = {}


def __getattr__(name: str) -> Any:
    """What entry points of these tests lead to."""
    if name in MADE:
        return MADE[name]
    raise AttributeError(name)


@pytest.fixture
def entry(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Make entry points out of functions, beside our own."""
    real = importlib.metadata.entry_points(group=renderers.ENTRY_POINTS)

    def points(**functions: Callable[[], Any]) -> None:
        MADE.update(functions)
        extra = [
            importlib.metadata.EntryPoint(name, f"{__name__}:{name}", renderers.ENTRY_POINTS) for name in functions
        ]
        # A third party's come first, as they may.
        monkeypatch.setattr(importlib.metadata, "entry_points", lambda **_: [*extra, *real])
        renderers.registry.cache_clear()

    yield points
    MADE.clear()
    renderers.registry.cache_clear()


def test_our_own_are_found() -> None:
    assert {"native-f64", "native-f32", "numpy-f64", "numpy-f32"} <= {entry.name for entry in renderers.all()}
    assert all(isinstance(entry, Renderer) for entry in renderers.all())
    assert "native" not in renderers.registry().failures
    assert renderers.get("native-f32").version() == renderers.get("native-f64").version()


def test_a_third_party_adds_its_own(entry: Callable[..., None]) -> None:
    entry(third=lambda: [Double(name="third")])
    assert renderers.get("third").name == "third"
    assert renderers.get("third") in renderers.available()


def broken() -> Any:
    raise RuntimeError("no licence")


def test_a_third_party_that_fails_is_reported_and_stops_nobody(entry: Callable[..., None]) -> None:
    entry(broken=broken, third=lambda: [Double(name="third")])
    found = renderers.registry()
    assert "RuntimeError: no licence" in found.failures["broken"]
    assert {"third", "native-f64"} <= set(found.renderers)


def test_a_third_party_that_cannot_be_imported_is_reported(
    entry: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    entry()
    gone = importlib.metadata.EntryPoint("gone", "no_such_package:renderers", renderers.ENTRY_POINTS)
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda **_: [gone])
    renderers.registry.cache_clear()
    assert "no_such_package" in renderers.registry().failures["gone"]
    assert renderers.all() == ()


def test_what_is_no_renderer_is_reported(entry: Callable[..., None]) -> None:
    entry(odd=lambda: ["a string"])
    assert "lacks what a renderer has" in renderers.registry().failures["odd"]


def test_our_names_cannot_be_taken(entry: Callable[..., None]) -> None:
    entry(thief=lambda: [Double(name="native-f64")])
    assert isinstance(renderers.get("native-f64"), Native)
    assert "'native-f64' is taken" in renderers.registry().failures["thief"]


def test_a_name_without_variant_means_the_best_that_can_run(entry: Callable[..., None]) -> None:
    fast, slow = Double(name="tool@fast"), Double(name="tool@slow")
    entry(tool=lambda: [fast, slow])
    assert renderers.get("tool") is fast
    fast.absent = "no such hardware"
    assert renderers.get("tool") is slow
    assert renderers.get("tool@fast") is fast
    assert fast not in renderers.available()
    slow.absent = "not installed"
    assert renderers.get("tool").unavailable() == "no such hardware"


def test_an_unknown_name_says_which_there_are() -> None:
    with pytest.raises(renderers.UnknownRendererError, match="unknown renderer 'natve-f64'") as error:
        renderers.get("natve-f64")
    assert error.value.hint == "did you mean 'native-f64'?"
    with pytest.raises(renderers.UnknownRendererError) as error:
        renderers.get("zzzzzz")
    assert error.value.hint.startswith("known renderers: ")


@pytest.mark.parametrize("make", [Native, Reference])
@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_ours_deliver_what_they_promise(make: Any, precision: Any) -> None:
    renderer, scene = make(precision), doubles.full()
    settings = Settings(max_reflections=2)
    promised = renderer.passes(scene, settings)
    assert promised == names(len(scene.lights), 2, margins=make is Reference)
    drawn = renderer.render(scene, promised, settings)
    assert tuple(drawn) == promised
    assert drawn["beauty"].dtype == ("float64" if precision == "f64" else "float32")
    assert renderer.unavailable() is None
    claim = renderer.uncertainty(scene, settings)
    assert UNIT_ROUNDOFF[precision] < claim.unit < claim.silhouette < 100 * UNIT_ROUNDOFF[precision]
    assert set(claim.absolute) == {"color", "length", "position", "normal"}


def test_an_absolute_error_of_a_pass_stands_before_that_of_its_quantity() -> None:
    claim = Uncertainty(
        0, 0, 0, 0, 0, {"color": 1.0, "reflection": 2.0, "reflection.*": 3.0, "length": 4.0, "depth": 5.0}
    )
    found = {name: claim.absolute_of(name) for name in names(1, margins=False)}
    assert {name for name, value in found.items() if value == 1} == {
        "beauty",
        "ambient",
        "diffuse",
        "specular",
        "direct",
    }
    assert found["reflection"] == 2
    assert {found[f"reflection.{k}"] for k in (1, 2, 3)} == {3}
    assert found["depth"] == 5
    assert found["position"] == found["normal"] == found["shadow.L0"] == found["id"] == 0
