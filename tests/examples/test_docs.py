"""The page on clusters, followed line by line: what one machine can do is done here, with a real scheduler over loopback."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

import structid as si

PAGE = (Path(__file__).parents[2] / "docs" / "how_to" / "cluster.md").read_text(encoding="utf-8")


def commands(section):
    """Lines of the shell blocks of a section of the page, without their comments."""
    text = re.search(rf"^## {section}\..*?(?=^## |\Z)", PAGE, re.M | re.S).group()
    blocks = re.findall(r"```sh\n(.*?)```", text, re.S)
    return [line.split("  #")[0].strip() for block in blocks for line in block.splitlines() if line.strip()]


@pytest.fixture
def shell(tmp_path):
    """Runs a line of the page where the study is; what was left running in the background is killed at the end."""
    bin_folder = tmp_path / "bin"
    bin_folder.mkdir()
    for name, module in (("structid", "structid.cli.main"), ("dask", "dask.__main__")):
        script = bin_folder / name
        script.write_text(f"#!/bin/sh\nexec {sys.executable} -c 'from {module} import main; main()' \"$@\"\n")
        script.chmod(0o755)
    environment = dict(os.environ, PATH=f"{bin_folder}{os.pathsep}{os.environ['PATH']}")
    background = []

    def run(line):
        if line.endswith("&"):
            background.append(
                subprocess.Popen(
                    line.rstrip("& "),
                    shell=True,
                    cwd=tmp_path,
                    env=environment,
                    start_new_session=True,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )
            )
            time.sleep(3.0)
            return None
        return subprocess.run(
            line, shell=True, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=200
        )

    yield run
    for process in background:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def shrink(path):
    text = path.read_text()
    text = text[: text.index("[observation]")].replace('"11 s"', '"5 s"')
    path.write_text(text + '[campaign]\nruns = 30\nmethod = "sobol"\n')


@pytest.mark.slow
def test_the_page_on_clusters_line_by_line(shell, tmp_path):
    pytest.importorskip("distributed")
    new, *rest = commands(1)
    assert shell(new).returncode == 0
    shrink(tmp_path / "my_structure.toml")
    assert [line.split()[1] for line in rest] == ["check", "run", "runs", "runs", "run", "run"]
    for line in rest:
        done = shell(line)
        assert done.returncode == 0, (line, done.stdout, done.stderr)
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port = str(s.getsockname()[1])
    lines = [line.replace("8786", port) for line in commands(2)]
    assert len(lines) == 3
    for line in lines:
        done = shell(line.replace("scheduler --", "scheduler --no-dashboard --"))
    assert done.returncode == 0, (done.stdout, done.stderr)
    here, there = si.open_runs(tmp_path / "out" / "runs.h5"), si.open_runs(tmp_path / "out_dask" / "runs.h5")
    assert there.done.all() and (here.values == there.values).all()


def test_the_python_on_the_page_is_python():
    for block in re.findall(r"```python\n(.*?)```", PAGE, re.S):
        compile(block, "cluster.md", "exec")
