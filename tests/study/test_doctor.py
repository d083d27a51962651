"""structid doctor: which engine runs here, and what to do where it is the slow one."""

import pytest

from commands import structid
from structid.engine.lanes import machine


@pytest.fixture(autouse=True)
def asked_anew():
    machine.why_not.cache_clear()
    yield
    machine.why_not.cache_clear()


def said(folder):
    called = structid("doctor", cwd=folder)
    assert called.returncode == 0
    return called.stdout


@pytest.mark.skipif(bool(machine.why_not()), reason="no lanes here")
def test_it_names_the_engine_and_the_caches(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    found = said(tmp_path)
    assert "vector code" in found and machine.processor() in found
    assert f"{tmp_path}/structid/lanes" in found and "is not writable" not in found


def test_it_says_why_loops_run_on_jax(tmp_path, monkeypatch):
    monkeypatch.setenv("STRUCTID_ENGINE", "jax")
    assert "JAX runs the time integration" in said(tmp_path) and "STRUCTID_ENGINE=jax" in said(tmp_path)


def test_without_llvmlite_it_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(machine, "_machine", lambda: (_ for _ in ()).throw(ImportError("No module named 'llvmlite'")))
    assert "No module named 'llvmlite'" in said(tmp_path)


def test_it_says_where_no_cache_can_be_kept(tmp_path, monkeypatch):
    (tmp_path / "structid").write_text("a file where the folder should be")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert "is not writable: every process compiles everything again" in said(tmp_path)


def test_it_names_the_font_and_what_brings_what_is_missing(tmp_path):
    found = said(tmp_path)
    assert "DejaVuSans" in found and "lacks" not in found
    assert "distributed" in found and ("pip install 'structid[opensees]'" in found or "openseespy   3" in found)
