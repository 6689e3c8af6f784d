"""The C side of the wire, compiled once for a run."""

from pathlib import Path

import pytest

from hatch_build import find_compiler
from studies.c_wire import Wire, compile_wire


@pytest.fixture(scope="session")
def wire(tmp_path_factory: pytest.TempPathFactory) -> Wire:
    """Compile with warnings as errors; CC may bring sanitizers (test_sanitized.py)."""
    compiler = find_compiler()
    if compiler is None:
        pytest.skip("no C compiler here: install gcc")
    folder: Path = tmp_path_factory.mktemp("c")
    return Wire(compile_wire(folder, compiler=compiler))
