"""``cosim build``: components in files of one's own, wherever they lie, and what is said when one is wrong."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from instances import Instance

from cosim.commands.cli import main

LAG = '''\
"""A component of a user's."""

{imports}
from cosim.model import Plant, Record, parameter, variable


class Lag(Plant):
    """First-order lag.

        der(position) = (gain*command - position)/time_constant
    """

    gain: float = parameter(2.0, "m/V", "Static gain")
    time_constant: float = parameter(0.1, "s", "Time constant", min=1e-6)

    class State(Record):
        position: float = variable(0.0, "m", "Position")

    class Input(Record):
        command: float = variable(0.0, "V", "Command")

    class Output(Record):
        position: float = variable(0.0, "m", "Position")

    def derivative(self, t: float, x: State, u: Input) -> State:
        return self.State(position=({gain} * u.command - x.position) / self.time_constant)

    def output(self, t: float, x: State, u: Input) -> Output:
        return self.Output(position=x.position)
'''


def lag(folder: Path, imports: str = "", gain: str = "self.gain", name: str = "lag.py") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(LAG.format(imports=imports, gain=gain))
    return folder / name


def steady(path: Path) -> float:
    """The output after ten time constants with the input 1."""
    with Instance(path) as fmu:
        fmu.initialize()
        fmu.set({"command": 1.0})
        fmu.step(0.0, 1.0)
        return fmu.get(["position"])[0]


@pytest.mark.parametrize("arguments", [[], ["--flavour", "python"]])
def test_a_file_anywhere(tmp_path: Path, arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    path = lag(tmp_path / "a folder", name="my-lag.py")
    assert main(["build", str(path), "-o", str(tmp_path / "out"), *arguments]) == 0
    assert steady(tmp_path / "out" / "Lag.fmu") == pytest.approx(2.0, rel=1e-4)
    said = capsys.readouterr().err
    assert "Lag is a draft" in said
    assert "icon, validation experiments with references, validation picture" in said
    with zipfile.ZipFile(tmp_path / "out" / "Lag.fmu") as archive:
        assert b"MIT" in archive.read("documentation/licenses/license.txt")
        assert b"The motion-cosim authors" not in archive.read("modelDescription.xml")


@pytest.mark.parametrize("flavour", ["native", "python"])
@pytest.mark.parametrize(("head", "encoding"), [("", "utf-8-sig"), ("# coding: cp1252\n", "cp1252")])
def test_a_file_in_any_encoding_of_python(tmp_path: Path, head: str, encoding: str, flavour: str) -> None:
    path = lag(tmp_path)
    path.write_bytes((head + path.read_text(encoding="utf-8").replace("Static gain", "Verstärkung")).encode(encoding))
    assert main(["build", str(path), "--flavour", flavour, "-o", str(tmp_path / "out")]) == 0
    assert steady(tmp_path / "out" / "Lag.fmu") == pytest.approx(2.0, rel=1e-4)


@pytest.mark.parametrize(
    "imports",
    ["import helper", "import helper as other; helper = other", "from helper import twice", "import helper  # beside"],
)
@pytest.mark.parametrize("flavour", ["native", "python"])
def test_files_beside_it(tmp_path: Path, imports: str, flavour: str) -> None:
    if ";" in imports:
        imports, gain = "import helper as other", "other.twice(self.gain)"
    else:
        gain = "twice(self.gain)" if "from" in imports else "helper.twice(self.gain)"
    path = lag(tmp_path, imports, gain)
    (tmp_path / "helper.py").write_text("from constants import TWO\n\n\ndef twice(x):\n    return TWO * x\n")
    (tmp_path / "constants.py").write_text("TWO = 2.0\n")
    assert main(["build", f"{path}:Lag", "-o", str(tmp_path / "out"), "--flavour", flavour]) == 0
    assert steady(tmp_path / "out" / "Lag.fmu") == pytest.approx(4.0, rel=1e-4)
    (tmp_path / "constants.py").write_text("TWO = 3.0\n")


def test_a_package_with_relative_imports(tmp_path: Path) -> None:
    path = lag(tmp_path / "parts" / "plants", "from ..numbers_of import TWO", "TWO * self.gain")
    for folder in (tmp_path / "parts", tmp_path / "parts" / "plants"):
        (folder / "__init__.py").write_text("")
    (tmp_path / "parts" / "numbers_of.py").write_text("TWO = 2.0\n")
    assert main(["build", str(path), "-o", str(tmp_path / "out"), "--flavour", "both"]) == 0
    for flavour in ("native", "python"):
        assert steady(tmp_path / "out" / flavour / "Lag.fmu") == pytest.approx(4.0, rel=1e-4)


def test_fmi_3(tmp_path: Path) -> None:
    assert main(["build", str(lag(tmp_path)), "-o", str(tmp_path / "out"), "--fmi", "3"]) == 0
    with zipfile.ZipFile(tmp_path / "out" / "Lag.fmu") as archive:
        assert b'fmiVersion="3.0"' in archive.read("modelDescription.xml")


TWO = "from cosim.model import Source\n\n\nclass One(Source):\n    pass\n\n\nclass Two(Source):\n    pass\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x = (1\n", r"wrong.py, line 1: '(' was never closed. Python cannot read this line."),
        ("import nowhere_to_be_found\n", "wrong.py, line 1: importing it failed: ModuleNotFoundError: No module named"),
        ("x = 1\ny = 1 / 0\n", "wrong.py, line 2: importing it failed: ZeroDivisionError"),
        ("raise SystemExit(3)\n", "wrong.py, line 1: importing it failed: SystemExit: 3."),
        ("x = 1\n", "wrong.py: has no component. Derive a class from Plant, Controller or Source of cosim.model."),
        (TWO, "wrong.py: has 2 components: One (wrong.py, line 4); Two (wrong.py, line 8). Name one: wrong.py:One"),
        (
            "from cosim.model import Choice\n\n\nclass Way(Choice):\n    a = 1, 'A'\n    b = 1, 'B'\n",
            "wrong.py, line 4: Way.b has the number 1 of a.",
        ),
    ],
)
def test_a_wrong_file(tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, said: str) -> None:
    path = tmp_path / "wrong.py"
    path.write_text(text)
    assert main(["build", str(path), "-o", str(tmp_path)]) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.glob("*.fmu"))


def test_remarks_are_told_at_every_build(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = lag(tmp_path / "own", gain="2.0")
    for state in ("built", "unchanged"):
        assert main(["build", str(path), "-o", str(tmp_path / "out")]) == 0
        captured = capsys.readouterr()
        assert state in captured.out
        assert "note: Lag: no equation uses the parameter gain. Take it out, or use it." in captured.err


def test_everything_wrong_with_the_command_is_told_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = lag(tmp_path)
    names = [f"{path}:Leg", str(tmp_path / "leg.py"), "BalscrewStage"]
    assert main(["build", *names, "-o", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "lag.py: has no component 'Leg'. Did you mean 'Lag'?" in said
    assert "leg.py: there is no such Python file. Did you mean 'lag.py'?" in said
    assert "no component 'BalscrewStage'. Did you mean 'BallscrewStage'?" in said


def test_a_wrong_component_names_its_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = lag(tmp_path, gain="max(self.gain, u.command)")
    assert main(["build", str(path), "-o", str(tmp_path)]) == 2
    line = next(k for k, text in enumerate(path.read_text().splitlines(), start=1) if "max(" in text)
    said = capsys.readouterr().err
    assert f"lag.py, line {line}: Lag.derivative: a condition on values is used as a Python truth value" in said
    assert "minimum/maximum/clip for min/max" in said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--platform", "linux"], "--platform linux: there is no such platform. Did you mean 'linux64'?"),
        (["--fmi", "3", "--flavour", "python"], "--fmi 3: PythonFMU makes FMI 2.0 only."),
    ],
)
def test_wrong_options(tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str) -> None:
    assert main(["build", str(lag(tmp_path)), "-o", str(tmp_path), *arguments]) == 2
    assert said in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_to(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(["build", str(lag(tmp_path)), "-o", str(tmp_path / "file")]) == 1
    assert "Lag.fmu: cannot be written" in capsys.readouterr().err


LIBRARIES = ("numpy", "scipy", "casadi", "cosim", "dataclasses", "json", "signal", "fmus", "jinja2", "lxml")


@pytest.mark.parametrize("form", ["file", "package"])
def test_files_beside_a_component_hide_no_library(tmp_path: Path, form: str, capfd: pytest.CaptureFixture[str]) -> None:
    for name in LIBRARIES:
        file = tmp_path / (f"{name}.py" if form == "file" else f"{name}/__init__.py")
        file.parent.mkdir(exist_ok=True)
        file.write_text("raise RuntimeError('the wrong file is imported')\n")
    path = lag(tmp_path)
    # A process of its own: here the libraries are imported already.
    command = [sys.executable, "-P", "-m", "cosim", "build", str(path), "-o", str(tmp_path / "out")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, "wrong file" in done.stderr) == (0, False), done.stderr
    assert steady(tmp_path / "out" / "Lag.fmu") == pytest.approx(2.0, rel=1e-4)


@pytest.mark.parametrize(
    ("imports", "file", "top"),
    [
        ("import numpy as np", "numpy.py", "numpy"),
        ("from scipy import signal", "scipy/__init__.py", "scipy"),
        ("import dataclasses", "dataclasses.py", "dataclasses"),
        ("from json.decoder import JSONDecoder", "json/__init__.py", "json"),
        ("import helping_hand", "numpy.py", "numpy"),  # by a file that the component imports
    ],
)
def test_a_file_with_the_name_of_an_imported_library_is_told(
    tmp_path: Path, imports: str, file: str, top: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = lag(tmp_path, imports)
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text("value = 1.0\n")
    (tmp_path / "helping_hand.py").write_text("import numpy\n")
    assert main(["build", str(path), "-o", str(tmp_path / "out")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    importing = "helping_hand.py" if "helping_hand" in imports else "lag.py"
    mine = file.partition("/")[0]
    assert f"{importing}: 'import {top}' means {mine} beside it, but {top} is a module of Python or installed" in said
    assert f"Rename {mine} and its imports." in said


@pytest.mark.parametrize("flavour", ["native", "python"])
def test_files_of_one_name_beside_two_components(tmp_path: Path, flavour: str) -> None:
    for folder, gain in (("first", 2.0), ("second", 3.0), ("first", 2.0)):
        path = lag(tmp_path / folder, "from helper_of_two import GAIN", "GAIN")
        (tmp_path / folder / "helper_of_two.py").write_text(f"GAIN = {gain}\n")
        out = tmp_path / folder / "out"
        assert main(["build", str(path), "-o", str(out), "--flavour", flavour]) == 0
        assert steady(out / "Lag.fmu") == pytest.approx(gain, rel=1e-4)
