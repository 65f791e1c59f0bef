"""Arrays: elements belong to their indices, wherever the file has them."""

from __future__ import annotations

from pathlib import Path

import pytest
from fmu_files import Variable, write_fmu

from cosim.commands.cli import main
from cosim.errors import DescriptionError
from cosim.fmu.description import read_fmu
from cosim.system.ssp_write import write_ssp
from cosim.system.system import System, make_system, read_system
from cosim.system.toml_write import write_system


def elements(*names: str) -> list[Variable]:
    return [Variable(name, "parameter", i, start="0") for i, name in enumerate(names)]


def system(folder: Path, names: list[str], start: dict[str, object]) -> System:
    write_fmu(folder / "Array.fmu", [*elements(*names), Variable("y", "output", 99)])
    document = {
        "experiment": {"stop_time": 1, "step_size": 1},
        "instances": {"a": {"fmu": "./Array.fmu", "start": start}},
    }
    return make_system(document, name="array.toml", folder=folder)


ALPHABETIC = sorted(f"p[{i}]" for i in range(1, 11))
SHUFFLED = ["m[2,1]", "m[1,3]", "m[1,1]", "m[2,3]", "m[1,2]", "m[2,2]"]


@pytest.mark.parametrize(
    ("names", "start", "expected"),
    [
        (ALPHABETIC, {"p": list(range(1, 11))}, {f"p[{i}]": float(i) for i in range(1, 11)}),
        (["p[2]", "p[0]", "p[1]"], {"p": [5, 6, 7]}, {"p[0]": 5.0, "p[1]": 6.0, "p[2]": 7.0}),
        (["p[5]", "p[4]"], {"p": [1, 2]}, {"p[4]": 1.0, "p[5]": 2.0}),
        (
            SHUFFLED,
            {"m": [[11, 12, 13], [21, 22, 23]]},
            {f"m[{i},{j}]": 10.0 * i + j for i in (1, 2) for j in (1, 2, 3)},
        ),
        (["q[1, 2]", "q[1, 1]"], {"q": [[1, 2]]}, {"q[1, 1]": 1.0, "q[1, 2]": 2.0}),
        (["a[2].b[1]", "a[2].b[2]", "a[1].b[1]"], {"a[2].b": [1, 2]}, {"a[2].b[1]": 1.0, "a[2].b[2]": 2.0}),
        # an element by its own name, and the whole after it
        (ALPHABETIC[:2], {"p[10]": 3}, {"p[10]": 3.0}),
    ],
)
def test_values_reach_their_indices(
    tmp_path: Path, names: list[str], start: dict[str, object], expected: dict[str, float]
) -> None:
    read = system(tmp_path, names, start)
    assert read.instances[0].start == expected
    for other in (write_system(read, tmp_path / "s.toml"), write_ssp(read, tmp_path / "s.ssp")):
        assert read_system(other).instances[0].start == expected


@pytest.mark.parametrize(
    ("names", "start", "text"),
    [
        (["p[1]", "p[3]"], {"p": [1, 2]}, "start.p: the array has gaps: its elements are p[1], p[3]. Give each"),
        (["m[1,1]", "m[2,2]"], {"m": [[1, 2]]}, "start.m: the array has gaps"),
        (["m[1]", "m[1,2]"], {"m": [1, 2]}, "start.m: the array has gaps"),
        (SHUFFLED, {"m": [1, 2, 3, 4, 5, 6]}, "6 values for an array of 2 by 3 elements."),
        (SHUFFLED, {"m": [1, 2]}, "1 is no list: Array has an array of 2 by 3 elements here. Write a list of rows"),
        (SHUFFLED, {"m": [[1, 2], [3, 4]]}, "2 values in a row for an array of 2 by 3 elements."),
        (ALPHABETIC, {"p": [1, 2, 3]}, "start.p: 3 values for an array of 10 elements."),
        (SHUFFLED, {"m": [[1, 2, 3], [4, float("nan"), 6]]}, "start.m[2,2]: nan is not finite."),
    ],
)
def test_lists_that_do_not_fit_are_refused(
    tmp_path: Path, names: list[str], start: dict[str, object], text: str
) -> None:
    with pytest.raises(DescriptionError) as caught:
        system(tmp_path, names, start)
    assert text in caught.value.problems[0]


def test_an_element_before_its_whole_array_is_noted(tmp_path: Path) -> None:
    (note,) = system(tmp_path, ["p[1]", "p[2]"], {"p[2]": 9, "p": [1, 2]}).notes
    assert note.endswith("start.p: p[2] is given before the whole array, too: the array counts.")
    assert system(tmp_path, ["p[1]", "p[2]"], {"p": [1, 2], "p[2]": 9}).notes == ()


def test_an_override_of_the_whole_replaces_elements_given_before(tmp_path: Path) -> None:
    base = system(tmp_path, ["p[1]", "p[2]"], {"p": [1, 2], "p[2]": 9})
    assert base.instances[0].start == {"p[1]": 1.0, "p[2]": 9.0}
    assert base.changed({"a.p": [5, 6]}).instances[0].start == {"p[1]": 5.0, "p[2]": 6.0}
    assert base.changed({"a.p[1]": 7}).instances[0].start == {"p[1]": 7.0, "p[2]": 9.0}


def test_a_file_that_completes_another_replaces_its_array(tmp_path: Path) -> None:
    write_fmu(tmp_path / "Array.fmu", [*elements("n.p[1]", "n.p[2]"), Variable("y", "output", 99)])
    head = '[experiment]\nstop_time = 1\nstep_size = 1\n[instances.a]\nfmu = "./Array.fmu"\n'
    (tmp_path / "base.toml").write_text(f'{head}start = {{ n.p = [1, 2], "n.p[2]" = 9 }}\n', encoding="utf-8")
    (tmp_path / "s.toml").write_text('base = "base.toml"\n[instances.a]\nstart.n.p = [5, 6]\n', encoding="utf-8")
    assert read_system(tmp_path / "s.toml").instances[0].start == {"n.p[1]": 5.0, "n.p[2]": 6.0}


def test_info_tells_the_indices(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_fmu(tmp_path / "Array.fmu", elements(*SHUFFLED, "p[1]", "p[0]", "g[1]", "g[3]"))
    assert read_fmu(path).arrays["m"].shape == (2, 3)
    assert main(["info", str(path)]) == 0
    shown = {line.split("  ")[0].strip() for line in capsys.readouterr().out.splitlines()}
    assert {"m[1..2, 1..3]", "p[0..1]", "g[1]", "g[3]"} <= shown
    assert "m[1,1]" not in shown
