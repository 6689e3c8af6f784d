"""What the soak run says of its readings."""

from studies.soak import Reading, faults_of, growth_of

_MB = 2**20


def _readings(process: str, *, mb_per_h: float, filling_mb: float = 0.0, descriptors_per_h: float = 0.0) -> list[Reading]:
    """Two hours in steps of two minutes; in the first half hour a window fills by ``filling_mb``."""
    readings = []
    for step in range(60):
        hour = step / 30
        filled = filling_mb * min(1.0, hour / 0.5)
        readings.append(
            Reading(
                hour=hour,
                process=process,
                rss=int((50 + filled + mb_per_h * hour) * _MB),
                n_descriptors=30 + int(descriptors_per_h * hour),
                n_threads=12,
            )
        )
    return readings


def test_a_window_that_fills_in_the_first_third_is_no_growth() -> None:
    growth = growth_of("gateway", _readings("gateway", mb_per_h=0.0, filling_mb=40.0))
    assert abs(growth.rss_mb_per_h) < 0.01
    assert faults_of([growth], n_encounters=0, hours=2.0) == []


def test_a_leak_is_told_by_its_rate() -> None:
    growth = growth_of("gateway", [*_readings("gateway", mb_per_h=6.0), *_readings("mapper", mb_per_h=0.0)])
    assert abs(growth.rss_mb_per_h - 6.0) < 0.1
    assert any("memory of the gateway by 6.0 MB/h" in fault for fault in faults_of([growth], n_encounters=0, hours=2.0))


def test_a_mapper_may_grow_with_what_it_keeps_and_no_faster() -> None:
    growth = growth_of("mapper", _readings("mapper", mb_per_h=50.0))
    assert faults_of([growth], n_encounters=100_000, hours=2.0) == []
    assert len(faults_of([growth], n_encounters=10_000, hours=2.0)) == 1


def test_descriptors_that_pile_up_are_told() -> None:
    growth = growth_of("gateway", _readings("gateway", mb_per_h=0.0, descriptors_per_h=10.0))
    assert any("descriptors of the gateway" in fault for fault in faults_of([growth], n_encounters=0, hours=2.0))
