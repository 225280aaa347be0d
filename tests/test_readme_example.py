import os
import re
import subprocess
import sys
from pathlib import Path
import pytest
from tests.conftest import copy_log

ROOT = Path(__file__).resolve().parent.parent


def examples():
    readme = ROOT / "README.md"
    if not readme.exists():
        pytest.skip("there is no README.md yet")
    blocks = re.findall(r"^```python\n(.*?)^```", readme.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return [block for block in blocks if "async with Mapper" in block]


def test_the_example_of_the_readme_runs(tmp_path, demo_log):
    """The log is the beginning of the demo under the demo's name, so that the example need not name a test's file."""
    (example,) = examples()
    (tmp_path / "recordings").mkdir()
    copy_log(demo_log, tmp_path / "recordings/demo.mcap", seconds=1.5)
    (tmp_path / "example.py").write_text(example)
    done = subprocess.run(
        [sys.executable, "-W", "error", "example.py"], cwd=tmp_path, capture_output=True, text=True, timeout=160,
        check=False, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
