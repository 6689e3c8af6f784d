"""Workers that crash take no other test with them, and nobody waits for them for ever."""

import os
import subprocess
import sys
from pathlib import Path

_CONFTEST = """
from tests.one_worker import OneWorkerEach
def pytest_xdist_make_scheduler(config, log):
    return OneWorkerEach(config, log)
"""
_CRASHING = """
import os, pytest
@pytest.fixture(scope="module")
def shared():
    return 1
@pytest.mark.parametrize("number", range({n}))
def test_of_a_group(shared, number):
    assert number != {crash} or os._exit(1)
"""
_ALONE = """
import os, pytest
@pytest.mark.parametrize("number", range(40))
def test_alone(number):
    assert number != 7 or os._exit(1)
"""


def test_when_workers_crash_all_other_tests_are_run_once_and_nothing_waits_for_ever(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text(_CONFTEST)
    (tmp_path / "test_early.py").write_text(_CRASHING.format(n=9, crash=4))
    (tmp_path / "test_last_of_all.py").write_text(_CRASHING.format(n=3, crash=2))
    (tmp_path / "test_alone.py").write_text(_ALONE)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    flags = ["-q", "-p", "xdist", "-p", "no:cacheprovider", "-n3", "--dist=loadgroup", f"--rootdir={tmp_path}"]
    line = [sys.executable, "-m", "pytest", *flags, str(tmp_path)]
    bare = os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}  # other plugins take seconds to import, in each of six processes
    ran = subprocess.run(line, env=bare, capture_output=True, text=True, check=False, timeout=300)
    assert "3 failed, 49 passed" in ran.stdout, ran.stdout
