"""Draw who talks to whom: docs/pictures/architecture.svg. Part of ``make pictures``."""

from html import escape
from pathlib import Path

_WIDTH, _HEIGHT = 960, 400
_INK, _PAPER, _FILL, _LINE = "#1b2430", "#ffffff", "#eef3f8", "#4a6785"
_TIP = (
    '<marker id="tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" orient="auto-start-reverse">'
    f'<path d="M0 0L10 5L0 10z" fill="{_LINE}"/></marker>'
)

# Left edge, top, width, height; title; lines below it.
_BOXES: tuple[tuple[int, int, int, int, str, tuple[str, ...]], ...] = (
    (20, 40, 150, 110, "backpacks", ("on insects: beacons,", "encounters, electrode", "firmware_protocol/c")),
    (20, 220, 150, 110, "biobot-sim", ("insects, backpacks,", "dongles that fail", "in one process")),
    (230, 130, 120, 110, "dongle", ("coordinator:", "native, XBee,", "Z-Stack, CAN")),
    (
        410,
        75,
        190,
        220,
        "biobot-gateway",
        (
            "radios, dialects",
            "clocks, encounters",
            "stimulation gate",
            "mission",
            "audit log",
            "",
            "journal (SQLite)",
            "/metrics, /healthz",
        ),
    ),
    (660, 40, 130, 110, "router", ("Zenoh over TLS,", "roles; beside it", "more gateways")),
    (660, 220, 130, 110, "biobot-mapper", ("store, map engine,", "confidence, jobs,", "REST, page")),
    (840, 130, 100, 110, "people", ("browser,", "programs,", "report")),
)
# From, to, label, where the label stands.
_ARROWS: tuple[tuple[tuple[int, int], tuple[int, int], str, tuple[int, int]], ...] = (
    ((170, 95), (230, 165), "radio", (206, 118)),
    ((170, 275), (230, 215), "pty, TCP", (222, 264)),
    ((350, 185), (410, 185), "serial", (380, 176)),
    ((600, 95), (660, 95), "Zenoh", (630, 86)),
    ((600, 275), (660, 275), "Zenoh", (630, 266)),
    ((725, 150), (725, 220), "Zenoh", (750, 190)),
    ((790, 260), (840, 215), "HTTP", (834, 254)),
)


def draw_architecture() -> str:
    """Return the picture as SVG."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" font-family="sans-serif" font-size="13" fill="{_INK}">',
        "<title>Backpacks and dongles, gateway, router, mapper, people: who talks to whom</title>",
        f"<defs>{_TIP}</defs>",
        f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="{_PAPER}"/>',
    ]
    for left, top, width, height, title, lines in _BOXES:
        parts.append(
            f'<rect x="{left}" y="{top}" width="{width}" height="{height}" rx="8" fill="{_FILL}" stroke="{_LINE}" stroke-width="1.5"/>'
        )
        middle = left + width // 2
        parts.append(f'<text x="{middle}" y="{top + 26}" text-anchor="middle" font-weight="bold" font-size="15">{escape(title)}</text>')
        parts += [
            f'<text x="{middle}" y="{top + 50 + 20 * at}" text-anchor="middle">{escape(line)}</text>' for at, line in enumerate(lines)
        ]
    for (x1, y1), (x2, y2), label, (x, y) in _ARROWS:
        ends = f'x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}"'
        parts.append(f'<line {ends} stroke="{_LINE}" stroke-width="1.5" marker-start="url(#tip)" marker-end="url(#tip)"/>')
        parts.append(f'<text x="{x}" y="{y}" text-anchor="middle" font-size="12">{escape(label)}</text>')
    says = "up: encounters, modes, status; down: stop, start, turn, mission orders. Nothing is published that is not in the journal."
    parts.append(f'<text x="{_WIDTH // 2}" y="{_HEIGHT - 25}" text-anchor="middle" font-size="14">{escape(says)}</text>')
    return "\n".join([*parts, "</svg>", ""])


def write_architecture(directory: Path) -> None:
    """Write the picture into a directory."""
    (directory / "architecture.svg").write_text(draw_architecture())
