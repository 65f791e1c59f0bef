"""Where blocks stand and wires run."""

from __future__ import annotations

import itertools
import re
from xml.etree import ElementTree

from cosim.result.diagram import Block, Wire, columns, draw

LOOP = [
    Wire(("t", "r"), ("c", "r"), "m"),
    Wire(("c", "u"), ("p", "u"), "N.m"),
    Wire(("p", "x"), ("c", "x"), "m"),
]


def test_a_loop_stands_along_its_forward_path_whatever_the_order() -> None:
    for names in itertools.permutations("tcp"):
        assert columns(names, LOOP) == {"t": 0, "c": 1, "p": 2}


def test_a_block_stands_right_of_all_that_feed_it() -> None:
    wires = [Wire(("a", "y"), ("b", "u")), Wire(("b", "y"), ("d", "u")), Wire(("a", "y"), ("d", "v"))]
    assert columns("abd", wires) == {"a": 0, "b": 1, "d": 2}


def test_a_ring_without_a_source_is_opened_at_its_first_block() -> None:
    wires = [Wire(("b", "y"), ("c", "u")), Wire(("c", "y"), ("b", "u"))]
    assert columns("bc", wires) == {"b": 0, "c": 1}


def _segments(path: str) -> list[tuple[float, float, float, float]]:
    """Straight pieces of a path of M, H and V."""
    pieces = re.findall(r"([MHV])([-\d.]+)(?: ([-\d.]+))?", path)
    x, y = float(pieces[0][1]), float(pieces[0][2])
    found: list[tuple[float, float, float, float]] = []
    for letter, value, _ in pieces[1:]:
        to = (float(value), y) if letter == "H" else (x, float(value))
        found.append((x, y, *to))
        x, y = to
    return found


def _drawn(blocks: str, wires: list[Wire]) -> tuple[list[tuple[Wire, list[tuple[float, ...]]]], list[list[float]]]:
    root = ElementTree.fromstring(draw([Block(name, f"Kind of {name}") for name in blocks], wires))
    space = "{http://www.w3.org/2000/svg}"
    groups = [g for g in root.iter(f"{space}g") if g.get("class") == "wire"]
    paths = [next(p for p in g.iter(f"{space}path") if p.get("class") is None).get("d") for g in groups]
    boxes = [[float(rect.get(key)) for key in ("x", "y", "width", "height")] for rect in root.iter(f"{space}rect")]
    return [(wire, [*map(tuple, _segments(path))]) for wire, path in zip(wires, paths, strict=True)], boxes


BUSY = [
    *LOOP,
    Wire(("t", "v"), ("p", "v")),
    Wire(("t", "r"), ("o", "r")),
    Wire(("p", "x"), ("o", "x")),
    Wire(("o", "d"), ("c", "d")),
    Wire(("o", "d"), ("o", "back")),
    Wire(("s", "y"), ("z", "u")),
]


def test_wires_of_different_outputs_never_lie_on_each_other() -> None:
    drawn, _ = _drawn("tcposz", BUSY)
    for (one, pieces), (other, others) in itertools.combinations(drawn, 2):
        if one.source == other.source:
            continue
        for a, b in itertools.product(pieces, others):
            for first, second in ((0, 1), (1, 0)):
                same = a[first] == a[first + 2] == b[first] == b[first + 2]
                low = max(min(a[second], a[second + 2]), min(b[second], b[second + 2]))
                high = min(max(a[second], a[second + 2]), max(b[second], b[second + 2]))
                assert not (same and high - low > 0.5), (one, other)


def test_no_wire_crosses_a_block_and_no_block_another() -> None:
    drawn, boxes = _drawn("tcposz", BUSY)
    assert len(boxes) == 6
    for _, pieces in drawn:
        for (x0, y0, x1, y1), (x, y, width, height) in itertools.product(pieces, boxes):
            inside = max(min(x0, x1), x + 1.0) < min(max(x0, x1), x + width - 1.0) or (
                x + 1.0 < x0 == x1 < x + width - 1.0
            )
            level = max(min(y0, y1), y + 1.0) < min(max(y0, y1), y + height - 1.0) or (
                y + 1.0 < y0 == y1 < y + height - 1.0
            )
            assert not (inside and level)
    for (x, y, width, height), (x1, y1, width1, height1) in itertools.combinations(boxes, 2):
        assert x + width <= x1 or x1 + width1 <= x or y + height <= y1 or y1 + height1 <= y


def test_an_input_of_several_wires_is_a_sum() -> None:
    wires = [Wire(("a", "y"), ("c", "u")), Wire(("b", "y"), ("c", "u")), Wire(("b", "y"), ("c", "v"))]
    texts = [text.text for text in ElementTree.fromstring(draw([Block(name) for name in "abc"], wires)).iter()]
    assert "\N{N-ARY SUMMATION} u" in texts
    assert "v" in texts


def test_names_are_escaped_and_nothing_is_needed() -> None:
    assert "&lt;a&gt;" in draw([Block("<a>", "&", "<t>")], [])
    ElementTree.fromstring(draw([], []))
