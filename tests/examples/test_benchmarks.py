"""A quick run of every benchmark works. Its figures go to a folder of their own, not among the published ones."""

import subprocess
import sys
from pathlib import Path

import pytest

import plain_code

ROOT = Path(__file__).parents[2]
BENCHMARKS = sorted(file for file in (ROOT / "benchmarks").glob("*.py") if "\ndef main(" in file.read_text())
RESULTS = sorted((ROOT / "benchmarks" / "results").glob("*.jsonl"))
PUBLISHED = (*(ROOT / "docs" / "benchmarks").rglob("*.md"), *RESULTS)


def test_every_benchmark_has_published_results():
    assert {file.stem for file in BENCHMARKS} == {file.stem for file in RESULTS}


@pytest.mark.slow
@pytest.mark.parametrize("benchmark", BENCHMARKS, ids=lambda file: file.stem)
def test_a_quick_run_works(benchmark, tmp_path, shared_data):
    published = [file.read_bytes() for file in PUBLISHED]
    quick = ROOT / "build" / "benchmarks" / f"{benchmark.stem}.jsonl"
    before = quick.read_text() if quick.exists() else ""
    command = [sys.executable, plain_code.__file__, str(benchmark), "--quick"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stderr[-2000:]
    assert quick.read_text().startswith(before) and len(quick.read_text()) > len(before)
    assert [file.read_bytes() for file in PUBLISHED] == published
