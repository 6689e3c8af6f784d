"""Progress is a bar on a terminal and lines elsewhere."""

import io

from studies.cases.progress import Progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_sees_a_bar_with_the_share_done_and_what_failed() -> None:
    terminal = Terminal()
    with Progress(label="sums", total=4, done=1, stream=terminal) as progress:
        for number in range(3):
            progress.step(has_failed=number == 1)
    shown = terminal.getvalue()
    assert "sums:" in shown
    assert "4/4" in shown
    assert "failed=1" in shown
    assert shown.rstrip().splitlines()[-1].startswith("sums: 4 of 4 cases, 1 failed, 1 of them before, in ")


def test_a_file_gets_a_line_whenever_the_time_has_passed_and_one_at_the_end() -> None:
    often, seldom = io.StringIO(), io.StringIO()
    for stream, every_s in ((often, 0.0), (seldom, 1e9)):
        with Progress(label="sums", total=3, stream=stream, every_s=every_s) as progress:
            progress.step(has_failed=False)
            progress.step(has_failed=True)
    assert [line.rsplit(",", 1)[0] for line in often.getvalue().splitlines()] == [
        "sums: 1 of 3 cases",
        "sums: 2 of 3 cases, 1 failed",
        "sums: 2 of 3 cases, 1 failed",
    ]
    assert " left" in often.getvalue().splitlines()[0]
    assert len(seldom.getvalue().splitlines()) == 1
