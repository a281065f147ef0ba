"""What a mistyped name was meant to be."""

from __future__ import annotations

from tracer.near import near


def test_capitals_do_not_matter_and_what_is_far_is_not_near() -> None:
    names = ("native-f32", "native-f64", "Mine")
    assert near("NATIVE-F32", names) == "native-f32"
    assert near("mien", names) == "Mine"
    assert near("povray", names) == ""
    assert near("nativ", names, cutoff=0.9) == ""
    assert near("x", ()) == ""
