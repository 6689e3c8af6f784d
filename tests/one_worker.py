"""Which tests go to one worker of pytest-xdist: those that share what is made once, by the text of their files.

pytest-xdist 3.8 puts a group's name behind a test's id, which pytest 9.2 no longer lets it do: its own groups are silently none.
"""

import re
from functools import cache
from pathlib import Path

from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController

_GROUP = re.compile(r'\bxdist_group\("([^"]+)"\)')
_SHARES = re.compile(r'^@pytest\.fixture\([^)]*scope="module"', re.MULTILINE)

_LEAST_PENDING = 2
"""A worker begins a test when it knows what comes after it."""


@cache
def group_of(path: Path) -> str | None:
    """Return the group of a file's tests: the name it gives, itself where they share a fixture, None where each may go anywhere."""
    text = path.read_text(encoding="utf-8")
    named = _GROUP.search(text)
    if named is not None:
        return named[1]
    return str(path) if _SHARES.search(text) else None


class OneWorkerEach(LoadScopeScheduling):  # type: ignore[misc]  # pytest-xdist has no types
    """A worker takes a group, or a test that is in none, as it becomes free; large groups go first.

    When a worker crashes pytest-xdist 3.8 hands out again all that it ever had, also what is done. Who is given only that, or a single
    test, waits for ever, for a worker begins a test when it knows the next one; and the test that crashed would crash the others.
    """

    def _split_scope(self, nodeid: str) -> str:
        name: str = nodeid.partition("::")[0]
        return group_of(self.config.rootpath / name) or nodeid

    def remove_node(self, node: WorkerController) -> str | None:
        """Forget a worker; return the test that it crashed in, if it did, and let others do what it has left undone."""
        units = {
            scope: {nodeid: False for nodeid, is_done in unit.items() if not is_done}
            for scope, unit in self.assigned_work.pop(node).items()
        }
        left = {scope: unit for scope, unit in units.items() if unit}
        if not left:
            return None
        scope = next(iter(left))
        crashed: str = next(iter(left[scope]))
        del left[scope][crashed]
        self.workqueue.update({scope: unit for scope, unit in left.items() if unit})
        for other in self.assigned_work:
            self._reschedule(other)
        return crashed

    def _reschedule(self, node: WorkerController) -> None:
        """Give a worker work until it has two tests, or tell it that there are no more."""
        if node not in self.registered_collections:
            return  # it has not told what it has collected, and is given work when it has
        super()._reschedule(node)
        while self.workqueue and not node.shutting_down and self._pending_of(self.assigned_work[node]) < _LEAST_PENDING:
            self._assign_work_unit(node)
        if not self.workqueue and self._pending_of(self.assigned_work[node]) < _LEAST_PENDING:
            node.shutdown()
