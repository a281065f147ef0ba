"""The examples in docs/ci.md do what it says."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sysconfig
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def test_every_example(tmp_path: Path) -> None:
    blocks = BLOCK.findall(DOCUMENT)
    assert {name for name, _ in blocks} == {"console", "python", "yaml"}
    shutil.copytree(ROOT / "scenes", tmp_path / "scenes")
    (code,) = (text for name, text in blocks if name == "python")
    (tmp_path / "test_mine.py").write_text(code)
    path = f"{sysconfig.get_path('scripts')}{os.pathsep}{os.environ['PATH']}"
    commands = [part for name, text in blocks if name == "console" for part in re.split(r"^\$ ", text, flags=re.M)[1:]]
    assert len(commands) == 3
    for part in commands:
        command, _, shown = part.partition("\n")
        done = subprocess.run(
            ["bash", "-c", command],
            cwd=tmp_path,
            env=os.environ | {"PATH": path, "COLUMNS": "160"},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, f"$ {command}\n{done.stdout}{done.stderr}"
        pattern = ".*".join(re.escape(words) for words in shown.split("..."))
        assert re.fullmatch(pattern, done.stdout, re.DOTALL), f"$ {command}\n{done.stdout}"
