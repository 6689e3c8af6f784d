"""Which tests go to one worker of pytest-xdist: those that share what is made once, by the text of their files.

pytest-xdist 3.8 puts a group's name behind a test's id, which pytest 9.2 no longer lets it do: its own groups are silently none.
"""

import re
from functools import cache
from pathlib import Path

from xdist.scheduler import LoadScopeScheduling

_GROUP = re.compile(r'\bxdist_group\("([^"]+)"\)')
_SHARES = re.compile(r'^@pytest\.fixture\([^)]*scope="module"', re.MULTILINE)


@cache
def group_of(path: Path) -> str | None:
    """Return the group of a file's tests: the name it gives, itself where they share a fixture, None where each may go anywhere."""
    text = path.read_text(encoding="utf-8")
    named = _GROUP.search(text)
    if named is not None:
        return named[1]
    return str(path) if _SHARES.search(text) else None


class OneWorkerEach(LoadScopeScheduling):  # type: ignore[misc]  # pytest-xdist has no types
    """A worker takes a group, or a test that is in none, as it becomes free; large groups go first."""

    def _split_scope(self, nodeid: str) -> str:
        name: str = nodeid.partition("::")[0]
        return group_of(self.config.rootpath / name) or nodeid
