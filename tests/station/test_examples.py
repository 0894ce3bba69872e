"""The examples of the documentation run as they stand."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = sorted((ROOT / "docs/examples").glob("*.py"))
SAYS = {
    "01_quick_start.py": "covered ",
    "02_one_run_by_hand.py": "all robots finished: covered ",
    "03_your_own_policy.py": "LongestFrontier ",
    "04_distance_decides.py": "2 m",
    "05_read_a_report.py": "submaps",
}


def test_every_example_is_known() -> None:
    assert [path.name for path in EXAMPLES] == sorted(SAYS)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs(path: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(path)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert SAYS[path.name] in done.stdout


def test_the_readme_shows_the_first_example() -> None:
    example = (ROOT / "docs/examples/01_quick_start.py").read_text()
    code = example.split('"""\n\n', 1)[1].strip()
    assert code in (ROOT / "README.md").read_text()
