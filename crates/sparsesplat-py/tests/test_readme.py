"""The one-liners of the README, as a new user types them."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
LINES = re.findall(r"^python -c .*$", README, re.MULTILINE)


def test_there_are_some():
    assert len(LINES) >= 3


@pytest.mark.parametrize("line", LINES)
def test_it_runs_in_an_empty_folder(line, tmp_path):
    _, *arguments = shlex.split(line)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    # As in any session of a user; without one, graphics drivers complain on standard error.
    environment.setdefault("XDG_RUNTIME_DIR", str(tmp_path))
    done = subprocess.run([sys.executable, *arguments], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() and not done.stderr
