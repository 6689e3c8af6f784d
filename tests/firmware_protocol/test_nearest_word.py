"""Laws of the nearest word: what is nearly one of those known is taken for it in words, and never in deed."""

import pytest

from firmware_protocol.nearest_word import CommandParser, did_you_mean


@pytest.mark.parametrize(
    ("word", "told"), [("rnu", "; did you mean 'run'?"), ("sevre", "; did you mean 'serve'?"), ("xyzzy", ""), ("", "")]
)
def test_the_nearest_of_those_known_is_named_where_one_is_near(word: str, told: str) -> None:
    assert did_you_mean(word, ["run", "serve", "merge"]) == told


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (["rnu"], "did you mean 'run'?"),
        (["run", "--jsno", "x"], "did you mean '--json'?"),
        (["run", "--jsno=x"], "did you mean '--json'?"),
        (["run", "--kind", "mpas"], "did you mean 'maps'?"),
        (["--verison", "run"], "did you mean '--version'?"),
    ],
)
def test_a_command_flag_or_value_that_is_not_known_names_the_nearest(
    given: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    parser = CommandParser(prog="it")
    parser.add_argument("--version", action="version", version="1")
    run = parser.add_subparsers().add_parser("run")
    run.add_argument("--json")
    run.add_argument("--kind", choices=("maps", "routes"))
    with pytest.raises(SystemExit) as ended:
        parser.parse_args(given)
    assert ended.value.code == 2
    assert told in capsys.readouterr().err
    assert parser.parse_args(["run", "--json", "a", "--kind", "maps"]).json == "a"
