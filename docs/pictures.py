"""`make docs`: every generated picture of the documents, with the project's own commands.

The same bits at every run, but for what the machine decides: the screenshots (its fonts and its Chromium), and the
curves of a ladder (Mitsuba's variant). The plot of speed is measured only where that is asked for, with SPEED=1 in the
environment; else it stays as it is.
"""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from urllib.parse import urlencode

import diagrams
import numpy as np
from PIL import Image

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
FIGURES = DOCS / "figures"

#: Ways to look at a pair, and what each file is called; the map of FLIP comes to them where the report has it.
MODES = ("side", "slider", "flip", "diff", "heat", "verdict")

#: The ladder that is shown: Mitsuba's own epsilons are seen there.
LADDER = "blocker-around"


def run(*command: str, folder: Path, expected: tuple[int, ...] = (0,), output: Path | None = None) -> None:
    """Run a command as a reader does, and show it."""
    print("$", *command, flush=True)
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.PIPE, check=False)
    if done.returncode not in expected:
        sys.exit(f"error: exit status {done.returncode}\n{done.stdout.decode(errors='replace')}")
    if output:
        output.write_bytes(done.stdout)


def save(image: Image.Image, path: Path, colors: int) -> None:
    """As a PNG of few colors. The file stays where nobody sees a difference: browsers round otherwise now and then."""
    few = image.convert("RGB").quantize(colors, dither=Image.Dither.NONE)
    if path.exists():
        with Image.open(path) as old:
            if old.size == few.size:
                there, now = (np.asarray(one.convert("RGB"), dtype=np.int16) for one in (old, few))
                if np.abs(there - now).max() <= 8:
                    return
    few.save(path, optimize=True)


def tutorial(folder: Path) -> None:
    """Both images of the tutorial, side by side, twice as large."""
    run("raytrace", "first.txt", "-o", "ours.ppm", folder=folder)
    run("python3", "tiny.py", "first.txt", folder=folder, output=folder / "mine.ppm")
    pair = [np.asarray(Image.open(folder / name)).repeat(2, 0).repeat(2, 1) for name in ("ours.ppm", "mine.ppm")]
    gap = np.full((pair[0].shape[0], 8, 3), 255, np.uint8)
    save(Image.fromarray(np.concatenate([pair[0], gap, pair[1]], axis=1)), FIGURES / "tutorial.png", 128)


def screenshots(folder: Path) -> None:
    """The report of the tutorial's mistake, in Chromium."""
    found = os.environ.get("WHITTED_CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    if not found:
        print("left as they are: the screenshots. No Chromium: apt-get install chromium, or set WHITTED_CHROMIUM")
        return
    from playwright.sync_api import sync_playwright

    check = ("whitted", "check", "first.txt", "--command", "python3 tiny.py {scene}", "--verdicts", "20")
    run(*check, "--report", "report", folder=folder, expected=(1,))
    address = (folder / "report" / "index.html").as_uri()
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        page = chromium.new_page(viewport={"width": 1280, "height": 680}, color_scheme="light")

        def shot(path: Path, colors: int, selector: str | None = None, **state: str) -> None:
            page.goto("about:blank")
            page.goto(f"{address}#/{urlencode({'scene': 'first.txt', 'at': '35,39', **state})}")
            page.wait_for_function("document.getElementById('v-values').dataset.complete")
            page.wait_for_timeout(500)
            if state.get("press"):
                page.keyboard.press(state["press"])
            data = page.locator(selector).screenshot() if selector else page.screenshot()
            save(Image.open(io.BytesIO(data)), path, colors)
            print(path.relative_to(ROOT), path.stat().st_size)

        shot(FIGURES / "report-check.png", 96, mode="side")
        page.set_viewport_size({"width": 1180, "height": 640})
        page.goto(address)
        page.wait_for_function("document.getElementById('v-stage').dataset.ready")
        flips = page.locator('#v-modes [data-mode="flipmap"]:not([aria-disabled="true"])').count()
        for mode in (*MODES, *["flipmap"] * bool(flips)):
            shot(FIGURES / f"viewer-{mode}.png", 64, "#v-stage", mode=mode)
        shot(FIGURES / "viewer-inspector.png", 24, "#v-inspector", mode="side")
        shot(FIGURES / "viewer-keys.png", 16, "#v-help", mode="side", press="?")
        page.set_viewport_size({"width": 900, "height": 900})
        page.goto((folder / "curves" / "index.html").as_uri())
        # From the legend to what is told of the curves; the table below is folded up.
        top, figure = page.locator(".lookup").bounding_box(), page.locator(f"#{LADDER}").bounding_box()
        edges = {"x": figure["x"] - 10, "y": top["y"] - 10, "width": figure["width"] + 20}
        clip = {**edges, "height": figure["y"] + figure["height"] - top["y"] - 10}
        save(Image.open(io.BytesIO(page.screenshot(clip=clip, full_page=True))), FIGURES / "ladder.png", 64)
        chromium.close()


def ladder(folder: Path) -> None:
    """The curves of one ladder."""
    command = ("whitted", "stability", "--ladder", LADDER, "--renderer", "native-f64,native-f32,mitsuba-path")
    run(*command, "--report", "curves", folder=folder)


def smaller(svg: str) -> str:
    """The same picture in fewer bytes: a tenth of a pixel is enough, and nobody reads the metadata."""
    svg = re.sub(r" *<metadata>.*?</metadata>\n?", "", svg, flags=re.DOTALL)
    svg = re.sub(r"<!--.*?-->\n?", "", svg, flags=re.DOTALL)
    svg = re.sub(r"<!DOCTYPE[^>]*>\n?", "", svg)
    svg = re.sub(r"-?\d+\.\d{2,}", lambda found: f"{float(found[0]):.1f}".removesuffix(".0"), svg)
    svg = re.sub(r"; font-family: 'DejaVu Sans'[^;\"]*", "", svg)
    style = "text{font-family: 'DejaVu Sans', sans-serif}"
    svg = svg if style in svg else svg.replace("</style>", f"{style}</style>", 1)
    return re.sub(r"\s*\n\s*", " ", re.sub(r">\s*\n\s*<", "><", svg)).strip() + "\n"


def speed() -> None:
    """Shrink the plot of speed; measure it anew if SPEED is set."""
    path = DOCS / "speed.svg"
    if os.environ.get("SPEED"):
        run("whitted", "speed", "--kernels", "--limit", "240", "-o", str(path), folder=ROOT)
    else:
        print("left as it is: docs/speed.svg, as it is measured: make docs SPEED=1")
    path.write_text(smaller(path.read_text(encoding="utf-8")), encoding="utf-8")


def main() -> None:
    """Make all."""
    FIGURES.mkdir(exist_ok=True)
    diagrams.main(FIGURES)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for example in ("first.txt", "tiny.py"):
            shutil.copy(DOCS / "examples" / example, folder)
        tutorial(folder)
        ladder(folder)
        screenshots(folder)
    speed()


if __name__ == "__main__":
    main()
