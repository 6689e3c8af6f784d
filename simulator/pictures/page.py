"""A page that plays a recorded run in a browser: one file, nothing fetched, opened from anywhere."""

import base64
import json
from importlib.resources import files

import numpy as np
import shapely
from numpy.typing import NDArray

from simulator.arenas.arena import Arena
from simulator.errors import ParameterError
from simulator.pictures.picture import summary
from simulator.pictures.recorded_run import RecordedRun

_STEPS = 65_535
"""A place on the page is one of so many across the arena's larger side: far below a pixel."""

_MAX_PLACES = 20_000_000
_MARK = "/*RUN*/"


def render_page(run: RecordedRun, *, trail_s: float) -> bytes:
    """Return the page as UTF-8.

    Raises
    ------
    ParameterError
        The run holds more places than a browser takes.
    """
    if run.position.shape[0] * run.position.shape[1] > _MAX_PLACES:
        raise ParameterError(
            name="number of places",
            got=run.position.shape[0] * run.position.shape[1],
            wanted=f"at most {_MAX_PLACES:,} on a page: make the run with fewer position_samples, or take --mp4",
        )
    landmarks, _ = run.standing_at(run.end_s)
    x_min, y_min, x_max, y_max = run.bounds
    scale = _STEPS / max(x_max - x_min, y_max - y_min)
    origin = np.array([x_min, y_min])

    def places(array: NDArray[np.float64]) -> str:
        return _pack(np.rint((array - origin) * scale), "<u2")

    data = {
        "title": f"{run.name}, {run.preset}, seed {run.seed}",
        "summary": summary(run, met=run.met_start_s.size, landmarks=int(landmarks.sum())),
        "unit": run.unit,
        "origin": [x_min, y_min],
        "extent": [x_max - x_min, y_max - y_min],
        "scale": scale,
        "trail_s": trail_s,
        "ids": run.ids.tolist(),
        "t_s": _pack(run.t_s, "<f8"),
        "position": places(run.position),
        "crosses": _pack(_crossings(run), "u1"),
        "arenas": [{"from_s": max(from_s, -1e300), "parts": _rings(arena)} for from_s, arena in run.arenas],
        "met": {
            "start_s": _pack(run.met_start_s, "<f8"),
            "end_s": _pack(run.met_end_s, "<f8"),
            "first": _pack(run.met_first, "<u4"),
            "second": _pack(run.met_second, "<u4"),
            "place": places(run.met_place),
        },
        "spell": {
            "start_s": _pack(run.spell_start_s, "<f8"),
            "end_s": _pack(run.spell_end_s, "<f8"),
            "row": _pack(run.spell_row, "<u4"),
            "commanded": _pack(run.spell_commanded, "u1"),
        },
        "landmark_rows": None if run.landmark_rows is None else run.landmark_rows.tolist(),
    }
    # "<" could end the script element in which the data stand.
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    template = files("simulator.pictures").joinpath("page.html").read_text(encoding="utf-8")
    before, after = template.split(_MARK)
    return (before + text + after).encode()


def _pack(array: NDArray[np.generic], kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(array).astype(kind).tobytes()).decode()


def _crossings(run: RecordedRun) -> NDArray[np.bool_]:
    """Tell whose straight line from each sample to the next leaves the arena: shape (m - 1, n)."""
    return np.array([run.track.crosses(k) for k in range(run.t_s.size - 1)], dtype=np.bool_)


def _rings(arena: Arena) -> list[list[list[list[float]]]]:
    parts = shapely.get_parts(arena.polygon)
    return [[np.asarray(ring.coords)[:, :2].tolist() for ring in (part.exterior, *part.interiors)] for part in parts]
