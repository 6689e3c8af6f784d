"""What is made once for several tests is made by one worker: the files tell the scheduler what pytest knows from what it collected."""

from typing import Any

import pytest

from tests.one_worker import group_of


def _shares(item: Any) -> bool:
    """Say whether a test asks for something that is made once for its file."""
    fixtures = item._fixtureinfo.name2fixturedefs.values()
    return any(one[-1].scope == "module" for one in fixtures)


def test_tests_that_share_something_are_in_one_group(request: pytest.FixtureRequest) -> None:
    for item in request.session.items:
        named = item.get_closest_marker("xdist_group")
        group = group_of(item.path)
        if named is not None:
            assert group == named.args[0], item.nodeid
        elif _shares(item):
            assert group == str(item.path), item.nodeid


def test_the_tests_of_this_file_share_nothing(request: pytest.FixtureRequest) -> None:
    assert group_of(request.path) is None
