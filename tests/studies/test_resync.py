"""Damage costs what it hits: every framing of ours keeps the frames beside it, and the study's streams are what they say."""

from pathlib import Path

import pytest

from studies.resync import DAMAGES, MOST_LOST, main, make_stream, measure_ours
from studies.wire_framings import FRAMINGS

NOWHERE = str(Path("no") / "python")


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("name", FRAMINGS)
def test_frames_beside_damaged_ones_come_through(name: str, damage: str) -> None:
    stream = make_stream(FRAMINGS[name], damage, n_frames=1000, share=0.02, seed=9)
    assert len(stream.intact) == 980
    loss = measure_ours(FRAMINGS[name], stream)
    assert loss.lost <= MOST_LOST
    assert loss.made_up <= 2


def test_the_same_seed_makes_the_same_stream_and_another_one_another() -> None:
    framing = FRAMINGS["znp"]
    first, again, other = (make_stream(framing, "byte lost", n_frames=200, share=0.1, seed=seed) for seed in (1, 1, 2))
    assert first == again
    assert first.chunks != other.chunks
    clean = b"".join(framing.encode(body) for body in first.sent)
    assert len(b"".join(first.chunks)) == len(clean) - 20


def test_the_table_has_a_row_for_each_framing_and_says_what_is_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--frames", "200", "--seeds", "1", "--peers", NOWHERE]) == 0
    told = capsys.readouterr()
    assert all(f"| {name} |" in told.out for name in FRAMINGS)
    assert "make wire-peers" in told.err
    with pytest.raises(SystemExit) as refused:
        main(["--share", "0.9"])
    assert refused.value.code == 2
