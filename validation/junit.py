"""Results as JUnit XML, which most CI systems show: a suite a pair of renderers, a case a scene and pass."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING

from validation.terminal import worst_of

if TYPE_CHECKING:
    from validation.compare import Comparison
    from validation.run import Validation

#: What XML 1.0 cannot hold, not even escaped.
UNFIT = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit(result: Validation) -> str:
    """The text of the file.

    A comparison that differs is a failure; so is what was judged and is not explained, as a case `verdicts` of its own.
    What failed is an error, what a renderer lacks and what is not done yet is skipped.
    """
    root = ET.Element("testsuites", name="whitted")
    for (renderer, reference), comparisons in _by_pair(result).items():
        suite = ET.SubElement(root, "testsuite", name=_fit(f"{renderer} against {reference}"))
        for comparison in comparisons:
            case = _case(suite, comparison.scene, comparison.pass_name)
            if not comparison.ok:
                text = "; ".join(comparison.reasons)
                _say(case, "failure", f"{text}{worst_of(comparison)}", "differs")
        for verdicts in result.verdicts:
            if (verdicts.renderer, verdicts.reference) == (renderer, reference):
                case = _case(suite, verdicts.scene, "verdicts")
                lines = [group.sentence() for group in verdicts.groups()]
                lines += [f"truth could not be had at {x} {y}" for x, y in verdicts.unproved]
                if not verdicts.explained:
                    wrong = [group.sentence() for group in verdicts.groups() if not group.explained]
                    _say(case, "failure", (wrong or lines)[0], "not explained", "\n".join(lines))
                else:
                    ET.SubElement(case, "system-out").text = _fit("\n".join(lines))
    rest = ET.Element("testsuite", name="whitted")
    for note in result.failures:
        _say(_case(rest, note.scene or "all scenes", note.renderer or "whitted"), "error", note.message, "failed")
    for clause in result.wrong:
        _say(_case(rest, "all scenes", "layout"), "failure", clause, "wrong")
    for scene, renderer, name in sorted(result.lacking):
        _say(_case(rest, scene, f"{renderer} {name}"), "skipped", f"{renderer} does not deliver {name}")
    for scene in result.unfinished:
        _say(_case(rest, scene, "all passes"), "skipped", "not done: the run ended early, or goes on")
    if len(rest):
        root.append(rest)
    for element in (*root, root):
        for kind, tag in (("tests", "testcase"), ("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
            element.set(kind, str(len(list(element.iter(tag)))))
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _by_pair(result: Validation) -> dict[tuple[str, str], list[Comparison]]:
    found: dict[tuple[str, str], list[Comparison]] = {}
    for comparison in result.comparisons:
        found.setdefault((comparison.renderer, comparison.reference), []).append(comparison)
    return found


def _case(suite: ET.Element, scene: str, name: str) -> ET.Element:
    return ET.SubElement(suite, "testcase", classname=_fit(scene), name=_fit(name))


def _say(case: ET.Element, tag: str, message: str, kind: str = "", text: str = "") -> None:
    """`message`: the first line is what lists show."""
    element = ET.SubElement(case, tag, message=_fit(message.partition("\n")[0]))
    if kind:
        element.set("type", kind)
    element.text = _fit(text or message)


def _fit(text: str) -> str:
    return UNFIT.sub("\ufffd", text)
