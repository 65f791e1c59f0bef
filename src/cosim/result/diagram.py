"""The block diagram of a system as SVG: instances as blocks, connections as wires with their units.

Blocks are in columns along the flow of signals, with the sources on the left (Sugiyama, Tagawa and Toda 1981). A wire
to the next column runs in the gap between both columns. A wire that skips columns runs above the blocks. A feedback
wire runs below them. Every output has its own track in each place, so wires may cross but never overlap.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape

PORT, HEAD, MARGIN, LANE = 20.0, 44.0, 14.0, 9.0
"""In pixels: height of a port, height of a block's head, border of the drawing, distance of parallel wires."""
LETTER, SMALL_LETTER = 7.6, 6.1
"""Width in pixels of a letter in the bold and in the small font. Rather wide, because fonts of browsers differ."""


@dataclass(frozen=True)
class Block:
    """An instance: its name, its ``kind`` (the FMU), and a ``text`` that appears under the mouse pointer."""

    name: str
    kind: str = ""
    text: str = ""


@dataclass(frozen=True)
class Wire:
    """A connection between (block, port) and (block, port)."""

    source: tuple[str, str]
    target: tuple[str, str]
    unit: str = ""
    """Written where the wire leaves its source."""
    change: str = ""
    """Written where the wire arrives: the factor or the other unit, if there is one."""


@dataclass
class _Box:
    """A block with its place in the drawing."""

    block: Block
    column: int = 0
    inputs: list[str] = field(default_factory=list[str])
    outputs: list[str] = field(default_factory=list[str])
    sums: set[str] = field(default_factory=set[str])
    """The inputs at which several wires end."""
    x: float = 0.0
    y: float = 0.0
    width: float = 0.0

    @property
    def height(self) -> float:
        return HEAD + PORT * max(len(self.inputs), len(self.outputs), 1) + 6.0

    def input_point(self, port: str) -> tuple[float, float]:
        return self.x, self.y + HEAD + PORT * (self.inputs.index(port) + 0.5)

    def output_point(self, port: str) -> tuple[float, float]:
        return self.x + self.width, self.y + HEAD + PORT * (self.outputs.index(port) + 0.5)


def draw(blocks: Sequence[Block], wires: Sequence[Wire]) -> str:
    """The diagram as SVG markup. Its colours are the CSS variables ``--text --grey --block --edge`` of the page.

    If the wires allow several orders, blocks keep the given order. Give them in the order of evaluation.
    """
    boxes = {block.name: _Box(block) for block in blocks}
    wires = [wire for wire in wires if wire.source[0] in boxes and wire.target[0] in boxes]
    for wire in wires:
        for ports, port in (
            (boxes[wire.source[0]].outputs, wire.source[1]),
            (boxes[wire.target[0]].inputs, wire.target[1]),
        ):
            if port not in ports:
                ports.append(port)
    ends = [wire.target for wire in wires]
    for name, port in ends:
        if ends.count((name, port)) > 1:
            boxes[name].sums.add(port)
    for name, column in columns(list(boxes), wires).items():
        boxes[name].column = column
    for box in boxes.values():
        sides = max(map(len, box.inputs), default=0) + max(map(len, box.outputs), default=0)
        titles = LETTER * len(box.block.name), SMALL_LETTER * len(box.block.kind)
        box.width = max(*titles, SMALL_LETTER * sides + 14.0, 60.0) + 20.0
    layout = _Layout(boxes, wires)
    return layout.svg()


def columns(names: Sequence[str], wires: Sequence[Wire]) -> dict[str, int]:
    """The column of each block: 0 for sources, otherwise at least one more than all blocks that feed it forwards.

    Blocks are placed one after the other. The next block is the first whose sources are all placed. If there is none,
    there is a loop; then the block with most sources placed is next. A wire from a later to an earlier block is
    feedback.
    """
    sources: dict[str, list[str]] = {name: [] for name in names}
    for wire in wires:
        if wire.source[0] != wire.target[0] and wire.source[0] not in sources[wire.target[0]]:
            sources[wire.target[0]].append(wire.source[0])
    column: dict[str, int] = {}
    left = list(names)
    while left:
        missing = {name: sum(source not in column for source in sources[name]) for name in left}
        ready = [name for name in left if missing[name] == 0]
        name = (
            ready[0] if ready else max(left, key=lambda name: (len(sources[name]) - missing[name], -left.index(name)))
        )
        column[name] = max((column[source] + 1 for source in sources[name] if source in column), default=0)
        left.remove(name)
    return column


def _groups(names: Sequence[str], wires: Sequence[Wire]) -> list[list[str]]:
    """Groups of connected blocks, each in the order of ``names``."""
    group = {name: i for i, name in enumerate(names)}
    for wire in wires:
        one, other = sorted((group[wire.source[0]], group[wire.target[0]]))
        group = {name: one if number == other else number for name, number in group.items()}
    return [[name for name in names if group[name] == number] for number in dict.fromkeys(group.values())]


class _Layout:
    """Places of all blocks and wires."""

    def __init__(self, boxes: Mapping[str, _Box], wires: Sequence[Wire]) -> None:
        self._boxes = boxes
        self._wires = wires
        self._marks: list[str] = []
        last = max((box.column for box in boxes.values()), default=0)
        self._lanes: dict[int, dict[tuple[str, ...], int]] = defaultdict(dict)
        """For each gap (gap n is left of column n), the lane number of each vertical piece of wire."""
        for wire in wires:
            self._claim(wire)
        self._left, self._gap = self._across(last)
        self.width = self._left[last] + self._column_width(last) + self._gap[last + 1] + MARGIN
        self.height = self._down()

    def _forward(self, wire: Wire) -> int:
        """Number of columns from source to target; negative for feedback."""
        return self._boxes[wire.target[0]].column - self._boxes[wire.source[0]].column

    def _claim(self, wire: Wire) -> None:
        """Take the lanes that a wire needs."""
        leaving = self._lanes[self._boxes[wire.source[0]].column + 1]
        leaving.setdefault(("out", *wire.source), len(leaving))
        if self._forward(wire) != 1:
            arriving = self._lanes[self._boxes[wire.target[0]].column]
            arriving.setdefault(("in", *wire.target), len(arriving))

    def _column_width(self, column: int) -> float:
        return max((box.width for box in self._boxes.values() if box.column == column), default=0.0)

    def _across(self, last: int) -> tuple[list[float], list[float]]:
        """Left edges of the columns; and widths of the gaps: left of each column, and right of the last."""
        gaps: list[float] = []
        for gap in range(last + 2):
            units = [SMALL_LETTER * len(w.unit) for w in self._wires if self._boxes[w.source[0]].column == gap - 1]
            changes = [SMALL_LETTER * len(w.change) for w in self._wires if self._boxes[w.target[0]].column == gap]
            lanes = LANE * (len(self._lanes[gap]) + 1) if self._lanes[gap] else 0.0
            gaps.append(
                max(units, default=0.0) + max(changes, default=0.0) + lanes + (16.0 if 0 < gap <= last else 8.0)
            )
        left = [MARGIN + gaps[0]]
        for column in range(last):
            left.append(left[-1] + self._column_width(column) + gaps[column + 1])
        return left, gaps

    def _down(self) -> float:
        """Place the blocks and draw the wires, one group below the other. Returns the height of the drawing."""
        top = MARGIN
        for group in _groups(list(self._boxes), self._wires):
            wires = [wire for wire in self._wires if wire.source[0] in group]
            over = list(dict.fromkeys(w.source for w in wires if self._forward(w) > 1))
            under = list(dict.fromkeys(w.source for w in wires if self._forward(w) < 1))
            begin = top + LANE * len(over) + (8.0 if over else 0.0)
            stacks: dict[int, list[_Box]] = defaultdict(list)
            for name in group:
                stacks[self._boxes[name].column].append(self._boxes[name])
            heights = {c: sum(box.height + 22.0 for box in stack) - 22.0 for c, stack in stacks.items()}
            tallest = max(heights.values())
            for column, stack in stacks.items():
                y = begin + 0.5 * (tallest - heights[column])
                for box in stack:
                    box.x = self._left[column] + 0.5 * (self._column_width(column) - box.width)
                    box.y = y
                    y += box.height + 22.0
            bottom = begin + tallest
            for wire in wires:
                forward = self._forward(wire)
                track = 0.0
                if forward > 1:
                    track = begin - 8.0 - LANE * over.index(wire.source)
                elif forward < 1:
                    track = bottom + 12.0 + LANE * under.index(wire.source)
                self._marks.append(self._wire(wire, track, direct=forward == 1))
            top = bottom + (12.0 + LANE * len(under) if under else 0.0) + 24.0
        return top - 24.0 + MARGIN

    def _lane(self, gap: int, key: tuple[str, ...]) -> float:
        """The x coordinate of a vertical piece of wire. Lanes begin to the right of the units in the gap."""
        units = [SMALL_LETTER * len(w.unit) for w in self._wires if self._boxes[w.source[0]].column == gap - 1]
        before = self._left[gap - 1] + self._column_width(gap - 1) if gap else MARGIN
        return before + max(units, default=0.0) + 8.0 + LANE * (self._lanes[gap][key] + 0.5)

    def _wire(self, wire: Wire, track: float, *, direct: bool) -> str:
        source, target = self._boxes[wire.source[0]], self._boxes[wire.target[0]]
        (x, y), (x_end, y_end) = source.output_point(wire.source[1]), target.input_point(wire.target[1])
        out = self._lane(source.column + 1, ("out", *wire.source))
        path = f"M{x:.1f} {y:.1f}H{out:.1f}"
        if direct:
            path += f"V{y_end:.1f}H{x_end - 5.0:.1f}"
        else:
            back = self._lane(target.column, ("in", *wire.target))
            path += f"V{track:.1f}H{back:.1f}V{y_end:.1f}H{x_end - 5.0:.1f}"
        branches = sum(other.source == wire.source for other in self._wires) > 1
        change = wire.change and f", {wire.change}"
        unit = wire.unit and f" [{wire.unit}]"
        said = escape(f"{'.'.join(wire.source)}{unit} \N{RIGHTWARDS ARROW} {'.'.join(wire.target)}{change}")
        # A wide invisible line makes it easy to point at the wire.
        return (
            f'<g class="wire"><title>{said}</title><path class="near" d="{path}"/><path d="{path}"/>'
            f'<path class="tip" d="M{x_end:.1f} {y_end:.1f}l-7 -3.5v7z"/>'
            + (f'<circle class="tip" cx="{out:.1f}" cy="{y:.1f}" r="2.2"/>' if branches else "")
            + _text(x + 4.0, y - 4.0, wire.unit, "unit")
            + _text(x_end - 9.0, y_end - 4.0, wire.change, "unit end")
            + "</g>"
        )

    def svg(self) -> str:
        """The whole drawing."""
        blocks = [_block(box) for box in self._boxes.values()]
        style = f"width:100%;max-width:{self.width:.0f}px;min-width:{0.75 * self.width:.0f}px"
        return "\n".join(
            [
                f'<svg xmlns="http://www.w3.org/2000/svg" role="img" aria-label="Block diagram" style="{style}" '
                f'viewBox="0 0 {self.width:.0f} {self.height:.0f}">',
                f"<style>{_STYLE}</style>",
                *self._marks,
                *blocks,
                "</svg>",
            ]
        )


_STYLE = (
    ".wire path{fill:none;stroke:var(--grey,#5c6670);stroke-width:1.2}"
    ".wire .near{stroke-width:8;stroke:transparent}.wire .tip,circle.tip{fill:var(--grey,#5c6670);stroke:none}"
    ".wire:hover path:not(.near):not(.tip){stroke-width:2.6;stroke:var(--text,#1f2429)}"
    ".block rect{fill:var(--block,#e8eef4);stroke:var(--edge,#33506b)}"
    "svg text{font-family:system-ui,'DejaVu Sans',sans-serif;fill:var(--text,#1f2429);font-size:11px}"
    "text.name{font-size:13px;font-weight:600;text-anchor:middle}"
    "text.kind{text-anchor:middle}text.kind,text.unit{fill:var(--grey,#5c6670)}"
    ".end{text-anchor:end}text.unit{font-size:10.5px}"
)


def _block(box: _Box) -> str:
    """A block with its names and ports."""
    middle = box.x + 0.5 * box.width
    texts = [
        _text(middle, box.y + 18.0, box.block.name, "name"),
        _text(middle, box.y + 33.0, box.block.kind, "kind"),
        *(_text(box.x + 6.0, box.input_point(port)[1] + 4.0, _input(box, port), "port") for port in box.inputs),
        *(_text(box.x + box.width - 6.0, box.output_point(port)[1] + 4.0, port, "port end") for port in box.outputs),
    ]
    title = f"<title>{escape(box.block.text)}</title>" if box.block.text else ""
    return (
        f'<g class="block">{title}<rect x="{box.x:.1f}" y="{box.y:.1f}" width="{box.width:.1f}" '
        f'height="{box.height:.1f}" rx="5"/>{"".join(texts)}</g>'
    )


def _input(box: _Box, port: str) -> str:
    return f"\N{N-ARY SUMMATION} {port}" if port in box.sums else port


def _text(x: float, y: float, text: str, kind: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" class="{kind}">{escape(text)}</text>' if text else ""
