"""Draw docs/figures/architecture.svg: the four packages, what passes between them, and the two sides that never meet.

Run from anywhere: `python docs/figures/architecture.py`.
"""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import escape

WIDTH, HEIGHT = 700, 640
INK, GREY, WHITE = "#1a1a1a", "#666666", "#ffffff"
# stroke and fill after Okabe and Ito, told apart with every common colour blindness
BLUE, ORANGE, GREEN = ("#0072b2", "#e3f0f8"), ("#b87400", "#fdf1da"), ("#00795a", "#ddf3ec")
PURPLE, RED, PLAIN = ("#8a4f7d", "#f6e8f2"), "#d55e00", (GREY, "#f2f2f2")


def box(x: int, y: int, width: int, height: int, colours: tuple[str, str], *, dashed: bool = False) -> str:
    """A rounded box."""
    dash = ' stroke-dasharray="8 6"' if dashed else ""
    stroke, fill = colours
    return f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="8" fill="{fill}" stroke="{stroke}" stroke-width="2.5"{dash}/>'


def words(x: int, y: int, lines: tuple[str, ...], *, size: int = 18, bold: bool = False, middle: bool = False, colour: str = INK) -> str:
    """Lines of text, the first at (x, y)."""
    weight, anchor = ("bold" if bold else "normal"), ("middle" if middle else "start")
    style = f'font-size="{size}" font-weight="{weight}" text-anchor="{anchor}" fill="{colour}"'
    return "".join(f'<text x="{x}" y="{y + round(1.3 * size) * row}" {style}>{escape(line)}</text>' for row, line in enumerate(lines))


def arrow(x1: int, y1: int, x2: int, y2: int, *, both: bool = False) -> str:
    """A line with a head, or one at each end."""
    start = ' marker-start="url(#head)"' if both else ""
    return f'<line x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}" stroke="{INK}" stroke-width="2.5" marker-end="url(#head)"{start}/>'


def drawing() -> str:
    """The whole figure as SVG."""
    head = (
        '<marker id="head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="6" markerHeight="6" orient="auto-start-reverse">'
        f'<path d="M0 0L10 5L0 10z" fill="{INK}"/></marker>'
    )
    parts = [
        f"<defs>{head}</defs>",
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="{WHITE}"/>',
        box(20, 20, 660, 190, BLUE),
        words(36, 50, ("hil: the bench",), size=21, bold=True),
        box(36, 68, 176, 126, (BLUE[0], WHITE)),
        words(124, 96, ("plan",), bold=True, middle=True),
        words(124, 122, ("machine file and", "experiment, every", "row in advance"), size=17, middle=True),
        arrow(212, 131, 254, 131),
        box(256, 68, 176, 126, (BLUE[0], WHITE)),
        words(344, 96, ("sample loop",), bold=True, middle=True),
        words(344, 122, ("one row per SYNC,", "limits held,", "motors stopped"), size=17, middle=True),
        arrow(432, 131, 486, 131),
        box(488, 68, 176, 126, (BLUE[0], WHITE)),
        words(576, 96, ("recording",), bold=True, middle=True),
        words(576, 122, ("identify, simulate,", "calibrate,", "diagnose"), size=17, middle=True),
        arrow(300, 196, 220, 284, both=True),
        words(120, 252, ("sample, command",), middle=True),
        arrow(390, 196, 470, 284, both=True),
        words(452, 252, ("exchange, stop",)),
        box(20, 286, 310, 110, GREEN),
        words(36, 316, ("controllers",), size=21, bold=True),
        words(36, 346, ("feedback, shapers, observers,", "models fitted to recordings")),
        box(370, 286, 310, 110, ORANGE),
        words(386, 316, ("drivers",), size=21, bold=True),
        words(386, 346, ("CANopen, serial IMU, Modbus,", "X-ray panel")),
        arrow(525, 396, 525, 432, both=True),
        box(250, 434, 430, 42, PLAIN),
        words(465, 461, ("one bus URL: CAN, vcan, UDP or lockstep",), middle=True),
        arrow(340, 476, 340, 516, both=True),
        arrow(575, 476, 575, 516, both=True),
        box(20, 518, 410, 104, PURPLE),
        words(36, 548, ("virtual_bus: emulated machine",), size=21, bold=True),
        words(36, 578, ("plant and effects, sensors, CANopen", "nodes, IMU, I/O, X-ray side")),
        box(470, 518, 210, 104, PLAIN, dashed=True),
        words(486, 548, ("real machine",), size=21, bold=True),
        words(486, 578, ("drives, encoders,", "IMU, brakes, panel")),
        f'<line x1="70" y1="398" x2="70" y2="516" stroke="{RED}" stroke-width="3" stroke-dasharray="7 6"/>',
        f'<path d="M58 445L82 469M82 445L58 469" stroke="{RED}" stroke-width="4"/>',
        words(94, 452, ("never import", "each other")),
    ]
    face = 'font-family="Helvetica, Arial, sans-serif"'
    title = "<title>The four packages and what passes between them</title>"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" {face}>{title}\n'
        + "\n".join(parts)
        + "\n</svg>\n"
    )


if __name__ == "__main__":
    Path(__file__).with_suffix(".svg").write_text(drawing(), encoding="utf-8")
