"""The framework of studies: verdicts follow from values, reports show what fails, runs repeat."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from cosim import study
from cosim.commands import study as command
from cosim.errors import DescriptionError, SimulationError
from cosim.study import Claim, Missing, Numbers, Outcome, Outcomes, Run, Study, report

RUN = Run("system.toml")


def outcomes(failed: str = "", **numbers: Numbers) -> Outcomes:
    found = [Outcome(name, RUN, values, None, 100) for name, values in numbers.items()]
    return Outcomes([*found, Outcome("broken", RUN, {}, None, 100, failed)] if failed else found)


# Rules and verdicts


@pytest.mark.parametrize(
    ("rule", "values", "published", "holds"),
    [
        (study.near(rel=0.02), {"": 102.0}, {"": 100.0}, True),
        (study.near(rel=0.02), {"": 102.1}, {"": 100.0}, False),
        (study.near(rel=0.02), {"": -102.0}, {"": -100.0}, True),
        (study.near(rel=0.02), {"": 100.0}, {"": -100.0}, False),
        (study.near(abs=0.7), {"": 10.25}, {"": 10.9}, True),
        (study.near(abs=0.7), {"": 10.1}, {"": 10.9}, False),
        (study.near(rel=0.1), {"a": 1.05, "b": 2.3}, {"a": 1.0, "b": 2.0}, False),
        (study.near(rel=0.1), {"b": 2.1, "a": 1.05}, {"a": 1.0, "b": 2.0}, True),
        (study.between(0.45, 0.55), {"a": 0.45, "b": 0.55}, {}, True),
        (study.between(0.45, 0.55), {"a": 0.5, "b": 0.56}, {}, False),
        (study.at_most(1.0), {"a": 1.0, "b": -5.0}, {}, True),
        (study.at_most(1.0), {"a": 0.0, "b": 1.1}, {}, False),
        (study.at_least(1.0), {"a": 1.0}, {}, True),
        (study.at_least(1.0), {"a": 2.0, "b": 0.9}, {}, False),
        (study.falling(), {"a": 3.0, "b": 2.0, "c": 1.0}, {}, True),
        (study.falling(), {"a": 3.0, "b": 3.0}, {}, False),
        (study.falling(), {"a": 1.0, "b": 3.0}, {}, False),
        (study.both(study.at_most(5.0), study.falling()), {"a": 4.0, "b": 3.0}, {}, True),
        (study.both(study.at_most(5.0), study.falling()), {"a": 6.0, "b": 3.0}, {}, False),
        (study.both(study.at_most(5.0), study.falling()), {"a": 3.0, "b": 4.0}, {}, False),
    ],
)
def test_rules(rule: study.Criterion, values: Numbers, published: Numbers, holds: bool) -> None:
    assert rule.holds(values, published) is holds


def test_comparing_other_things_than_were_published_is_an_error() -> None:
    with pytest.raises(DescriptionError, match=r"measured \['SMC'\] but published \['CSMC'\]: use equal labels"):
        study.near(rel=0.1).holds({"SMC": 1.0}, {"CSMC": 1.0})


GRADED = Claim(
    "C1",
    "The error is 10 um",
    10.0,
    "um",
    lambda o: o.number("smc", "error"),
    {"reproduced": study.near(rel=0.02), "order only": study.at_most(20.0)},
)


@pytest.mark.parametrize(
    ("value", "status"),
    [(10.1, "reproduced"), (9.7, "order only"), (25.0, "not reproduced"), (math.nan, "not reproduced")],
)
def test_the_measured_value_alone_decides_the_verdict(value: float, status: str) -> None:
    verdict = study.judge(GRADED, outcomes(smc={"error": value}))
    assert verdict.status == status
    assert list(verdict.measured) == [""]


def test_a_claim_without_measure_is_not_checkable() -> None:
    assert study.judge(Claim("C", "It works in practice", "no figures"), outcomes()).status == "not checkable"


def test_a_claim_whose_run_was_left_out_is_not_run() -> None:
    verdict = study.judge(GRADED, outcomes(other={"error": 10.0}))
    assert (verdict.status, verdict.reason) == ("not run", "run smc was left out")


def test_a_claim_whose_run_failed_is_never_reproduced() -> None:
    claim = dataclasses.replace(GRADED, measure=lambda o: o.number("broken", "error"))
    verdict = study.judge(claim, outcomes(failed="plant: fmi2DoStep returned fmi2Error"))
    assert verdict.status == "not checkable"
    assert verdict.reason == "run broken failed: plant: fmi2DoStep returned fmi2Error"


def test_a_study_with_doubled_or_halved_claims_is_refused() -> None:
    half = dataclasses.replace(GRADED, id="C2", verdicts={})
    with pytest.raises(DescriptionError) as caught:
        Study("T", "S", "", {}, (GRADED, GRADED, half), {})
    assert caught.value.problems == (
        "claim C1 is there 2 times: give each its own id.",
        "claim C2 has a measure without verdicts, or verdicts without a measure: give both or none.",
    )


# Text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (14.4, "14.4"),
        (28.2066, "28.21"),
        (0.00991264, "0.009913"),
        (212.4, "212.4"),
        (20520.4, "20520"),
        (100000.0, "100000"),
        (1.317e6, "1.317e6"),
        (-3.7e-10, "-3.7e-10"),
        (-0.25, "-0.25"),
        (math.nan, "none"),
        (math.inf, "inf"),
    ],
)
def test_four_figures(value: float, text: str) -> None:
    assert report.number(value) == text


def test_values_carry_labels_and_unit() -> None:
    claim = Claim("C", "", "", "µm")
    assert report.values({"SMC": 11.32, "CSMC": 2.965}, claim) == "SMC 11.32, CSMC 2.965 µm"
    assert report.values({"": 0.5}, dataclasses.replace(claim, unit="1")) == "0.5"
    units = dataclasses.replace(claim, unit={"e": "µm", "v": "µm/s"})
    assert report.values({"e": 1.0, "v": 2.0}, units) == "e 1 µm, v 2 µm/s"


def test_arrays_are_shown_as_tables() -> None:
    overrides = {"pulse.A": 0.5, **{f"pulse.table.amplitude[{i}]": 0.1 for i in range(1, 61)}}
    run = Run("x.toml", overrides, scaled={"plant.m": 1.000001})
    text = report.changed_values(Outcome("x", run, {}, None, 0))
    assert text == "pulse.A = 0.5, pulse.table.amplitude = table of 60, plant.m times 1.000001"


# A whole study

STUDY_TEXT = '''
"""A study of the fuzzy rules alone and of a stage that gets a parameter out of its bounds."""

import numpy as np

from cosim import plots
from cosim.study import Claim, Picture, Run, Study, at_least, near


def draw(outcomes, path):
    result = outcomes.result("long")
    series = plots.Series("", result.time, result["plant.position"])
    plots.plot_panels(path, [plots.Panel("Position", "m", (series,))])


STUDY = Study(
    title="A | B",
    source="Nobody",
    text="Some **text**.",
    runs={
        "short": Run("stage.toml", window=(0.0, 0.01), measure=lambda result, window: {"last": result.time[-1]}),
        "long": Run("stage.toml", {"plant.command": 12.0}, 0.1, keep_every=10),
        "bad": Run("stage.toml", {"plant.m": -1.0}),
    },
    claims=(
        Claim("C1", "F(t) = |u|", "0.05 s", "s", lambda o: o.number("short", "last"), {"reproduced": at_least(0.05)}),
        Claim("C2", "It is long", 0.1, "s", lambda o: o.number("short", "last"), {"reproduced": near(rel=0.01)}),
        Claim("C3", "It is bad", "bad", "s", lambda o: o.number("bad", "last"), {"reproduced": at_least(0.0)}),
        Claim("C4", "It is NaN", "none", "1", lambda o: {"x": np.nan}, {"reproduced": at_least(0.0)}),
    ),
    pictures={"position": Picture("Position", draw)},
)
'''
SYSTEM_TEXT = """
[experiment]
stop_time = 0.05
step_size = 1e-4
[instances.plant]
fmu = "BallscrewStage"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "small"
    path.mkdir()
    (path / "study.py").write_text(STUDY_TEXT)
    (path / "stage.toml").write_text(SYSTEM_TEXT)
    return path


def test_runs_repeat_bit_by_bit_whatever_the_number_of_processes(folder: Path, native: Path) -> None:
    one, two = (study.run_study(folder, jobs=jobs, fmus=native) for jobs in (1, 2))
    assert list(one) == list(two) == ["short", "long", "bad"]
    for name in ("short", "long"):
        assert dict(one[name].numbers) == dict(two[name].numbers)
        assert np.array_equal(one.result(name).rows, two.result(name).rows)


def test_runs_have_their_own_values_stop_time_and_thinning(folder: Path, native: Path) -> None:
    found = study.run_study(folder, fmus=native)
    assert found["short"].steps == 500
    assert found["short"].numbers["last"] == pytest.approx(0.05)
    assert found["short"].numbers["plant.rhs_evaluations"] > 0.0
    assert found["long"].steps == 1000
    assert found.result("long").time == pytest.approx(np.arange(101) * 1e-3)
    assert found.result("long")["plant.speed"][-1] == pytest.approx(14.4, rel=1e-3)
    with pytest.raises(Missing, match=r"run bad failed: .*plant\.start\.m: -1\.0 kg is below its minimum"):
        found["bad"]


def test_only_runs_that_match_are_run(folder: Path, native: Path) -> None:
    assert list(study.run_study(folder, pattern="s*", fmus=native)) == ["short"]
    with pytest.raises(DescriptionError, match=r"no run matches 'shirt'\. Did you mean 'short'"):
        study.run_study(folder, pattern="shirt", fmus=native)


def write(folder: Path, native: Path, output: Path) -> tuple[str, str, Mapping[str, Mapping[str, object]]]:
    found = study.run_study(folder, fmus=native)
    loaded = study.load_study(folder)
    verdicts = [study.judge(claim, found) for claim in loaded.claims]
    page = report.write_report(output, "small", loaded, found, verdicts)
    return (output / "report.md").read_text(), page.read_text(), json.loads((output / "figures.json").read_text())


def test_the_report_shows_every_claim_and_what_failed(folder: Path, native: Path, tmp_path: Path) -> None:
    text, page, figures = write(folder, native, tmp_path / "out")
    rows = {line.split(" | ")[0].strip("| "): line for line in text.splitlines() if line.startswith("| C")}
    assert rows["C1"] == r"| C1 | F(t) = \|u\| | 0.05 s | 0.05 s | at least 0.05 s | reproduced |"
    assert rows["C2"] == "| C2 | It is long | 0.1 s | 0.05 s | within 1 % of it | not reproduced |"
    assert re.search(r"run bad failed: .* \| at least 0 s \| not checkable \|$", rows["C3"])
    assert rows["C4"].endswith("| x none | at least 0 | not reproduced |")
    assert "| reproduced | 1 | C1 |" in text
    assert "| not reproduced | 2 | C2, C4 |" in text
    assert re.search(r"`bad`  \| `stage.toml`<br><small>plant.m = -1</small><br>failed: .* \| 0 \|", text)
    assert "![Position](position.png)" in text
    assert '<tbody class="claim" id="claim-C2" data-status="not-reproduced">' in page
    assert '<a href="#claim-C2">C2</a>' in page
    assert "F(t) = |u|" in page
    assert figures["claims"]["C4"] == {
        "kind": "paper",
        "verdict": "not reproduced",
        "unit": "1",
        "measured": {"x": None},
    }
    assert figures["runs"]["bad"].keys() == {"failure"}  # type: ignore[attr-defined]


def test_the_page_stands_alone(folder: Path, native: Path, tmp_path: Path) -> None:
    _, page, _ = write(folder, native, tmp_path / "out")
    sources = re.findall(r'src="([^"]*)"', page)
    assert sources
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    links = re.findall(r'href="([^"]*)"', page)
    assert all(link.startswith("#") and f'id="{link[1:]}"' in page for link in links)
    assert "http" not in page


def test_the_report_repeats(folder: Path, native: Path, tmp_path: Path) -> None:
    for name in ("one", "two"):
        write(folder, native, tmp_path / name)
    for file in ("report.md", "report.html", "figures.json", "position.png"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


def test_a_picture_without_its_run_says_so(folder: Path, native: Path, tmp_path: Path) -> None:
    found = study.run_study(folder, pattern="short", fmus=native)
    loaded = study.load_study(folder)
    verdicts = [study.judge(claim, found) for claim in loaded.claims]
    report.write_report(tmp_path / "out", "small", loaded, found, verdicts)
    text = (tmp_path / "out" / "report.md").read_text()
    assert "Not drawn: run long was left out." in text
    assert [verdict.status for verdict in verdicts] == ["reproduced", "not reproduced", "not run", "not reproduced"]


def test_the_command_fails_with_a_run_but_not_with_a_claim(
    folder: Path, native: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main(str(folder), tmp_path / "one", fmus=native) == 1
    said = capsys.readouterr()
    assert "error: run bad:" in said.err
    assert "1 reproduced, 2 not reproduced, 1 not checkable" in said.out
    assert command.main(str(folder), tmp_path / "two", runs="[sl]*", fmus=native) == 0
    assert (tmp_path / "two" / "report.html").is_file()


def test_an_unknown_study_is_named_with_a_suggestion() -> None:
    with pytest.raises(DescriptionError, match=r"no study 'shams201'\. Did you mean 'shams2010'"):
        study.find_study("shams201")


def test_a_file_without_a_study_is_refused(tmp_path: Path) -> None:
    (tmp_path / "study.py").write_text("STUDY = 3\n")
    with pytest.raises(DescriptionError, match=r"study\.py: STUDY is not a cosim\.study\.Study"):
        study.load_study(tmp_path)


def test_a_run_that_takes_its_process_down_is_told(folder: Path, native: Path) -> None:
    text = (folder / "study.py").read_text()
    dying = text.replace("lambda result, window: {", "lambda result, window: __import__('os')._exit(3) or {")
    (folder / "study.py").write_text(dying)
    with pytest.raises(SimulationError, match=r"a process died in one of the runs .*short.* Give jobs = 1"):
        study.run_study(folder, jobs=2, fmus=native)


# Readings, checks, spread


def test_a_check_agrees_or_differs() -> None:
    check = dataclasses.replace(GRADED, kind="check", verdicts={"agrees": study.near(rel=0.02)})
    assert study.judge(check, outcomes(smc={"error": 10.1})).status == "agrees"
    assert study.judge(check, outcomes(smc={"error": 11.0})).status == "differs"


def test_a_finding_has_no_verdict() -> None:
    finding = dataclasses.replace(GRADED, kind="finding", verdicts={})
    verdict = study.judge(finding, outcomes(smc={"error": 11.0}))
    assert (verdict.status, dict(verdict.measured)) == ("finding", {"": 11.0})


def test_a_status_of_another_kind_is_refused() -> None:
    check = dataclasses.replace(GRADED, kind="check")
    with pytest.raises(DescriptionError, match="rule for 'reproduced', which a check cannot get"):
        Study("T", "S", "", {}, (check,), {})


def test_another_reading_is_measured_and_not_counted() -> None:
    reading = study.Reading("elsewhere", lambda o: o.number("csmc", "error"))
    verdict = study.judge(
        dataclasses.replace(GRADED, readings=(reading,)), outcomes(smc={"error": 25.0}, csmc={"error": 10.0})
    )
    assert verdict.status == "not reproduced"
    assert [(r.setting, r.status) for r in verdict.readings] == [("elsewhere", "reproduced")]
    assert report.counts([verdict], "paper") == {"not reproduced": 1}


def test_perturbed_copies_give_a_spread_and_must_keep_the_rule_too() -> None:
    found = outcomes(**{"smc": {"error": 10.1}, "smc~1": {"error": 10.15}, "smc~2": {"error": 12.0}})
    verdict = study.judge(GRADED, found)
    assert dict(verdict.spread) == {"": (10.1, 12.0)}
    assert verdict.status == "order only"
    calm = study.judge(GRADED, outcomes(**{"smc": {"error": 10.1}, "smc~1": {"error": 10.15}}))
    assert (calm.status, dict(calm.spread)) == ("reproduced", {"": (10.1, 10.15)})


# Claims as data

CLAIMS_TEXT = """
title = "T"
source = "S"
text = "Text"
[[spread]]
runs = ["sm*"]
parameters = ["plant.m"]
tolerance = { "plant.tolerance" = 0.1 }
[[tables]]
title = "Claims"
kind = "paper"
setting = "as the rest"
[[tables.claims]]
id = "C1"
text = "The ratio is 2"
published = 2.0
unit = "%"
values = { "" = "smc:error / csmc:error - 0.5" }
verdicts.reproduced = { near = 0.1, at_least = 1.0, why = "because" }
"""
RUNS = {"smc": Run("system.toml"), "csmc": Run("system.toml")}


def read(tmp_path: Path, text: str) -> Study:
    path = tmp_path / "claims.toml"
    path.write_text(text, encoding="utf-8")
    return study.read_study(path, RUNS, {})


def test_claims_are_read_with_unit_rules_reasons_and_copies(tmp_path: Path) -> None:
    found = read(tmp_path, CLAIMS_TEXT)
    claim = found.claims[0]
    assert claim.measure is not None
    measured = claim.measure(outcomes(smc={"error": 1.0}, csmc={"error": 2.0}))
    assert measured == {"": 0.0}
    rule = claim.verdicts["reproduced"]
    assert (rule.text, rule.why) == ("within 10 % of it and at least 1{unit}", "because")
    assert rule.holds({"": 2.1}, {"": 2.0})
    assert not rule.holds({"": 2.3}, {"": 2.0})
    assert claim.setting == "as the rest"
    assert list(found.runs) == ["smc", "csmc", "smc~1", "smc~2"]
    assert found.runs["smc~1"].scaled == {"plant.m": 1.000001}
    assert found.runs["smc~2"].scaled == {"plant.tolerance": 0.1}


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("smc:error /", "smcc:error /", r"claim C1: there is no run 'smcc'\. Did you mean 'smc'"),
        ("smc:error /", "smc_error /", r"claim C1: 'smc_error' is no figure of a run: write 'run:figure'"),
        ("- 0.5", "-0.5", r"is not a sum or product of terms"),
        (', why = "because"', "", r"claim C1: a threshold has no reason: give why"),
        ("near = 0.1, at_least = 1.0, ", "", r"no condition: give near"),
        ("reproduced", "agrees", r"rule for 'agrees', which a paper cannot get"),
        ("reproduced", "confirmed", r"claims\.toml: tables\[1\]\.claims\[1\]\.verdicts\.confirmed"),
        ('unit = "%"', 'unti = "%"', r"claims\.toml: tables\[1\]\.claims\[1\]\.unti: unknown key"),
        ('["sm*"]', '["st*"]', r"spread: no run matches 'st\*'"),
        ('unit = "%"', 'unit = "%"\nwithout = 2.1', r"the tolerance 0\.2 is not below the effect 0\.1 that it tests"),
        ("near = 0.1,", "share_of_effect = 0.5,", r"share_of_effect needs the published values without the effect"),
        ('values = { "" =', 'measure = "x"\nvalues = { "" =', r"it has values and a measure"),
    ],
)
def test_a_wrong_claims_file_is_refused_before_any_run(tmp_path: Path, old: str, new: str, problem: str) -> None:
    assert old in CLAIMS_TEXT
    with pytest.raises(DescriptionError, match=problem):
        read(tmp_path, CLAIMS_TEXT.replace(old, new))


def test_a_share_of_an_effect_is_kept_or_not(tmp_path: Path) -> None:
    text = CLAIMS_TEXT.replace('unit = "%"', 'unit = "%"\nwithout = 1.0').replace(
        "near = 0.1,", "share_of_effect = 0.4,"
    )
    rule = read(tmp_path, text).claims[0].verdicts["reproduced"]
    assert rule.holds({"": 1.7}, {"": 2.0})
    assert not rule.holds({"": 1.5}, {"": 2.0})


@pytest.mark.parametrize("name", study.known_studies())
def test_every_threshold_of_the_studies_has_a_reason_and_no_tolerance_is_above_its_effect(name: str) -> None:
    """``read_study`` refuses a tolerance above the effect; here is that there are effects to be seen."""
    claims = study.load_study(study.known_studies()[name]).claims
    assert all(rule.why for claim in claims for rule in claim.verdicts.values())
    if name in ("rubio2015", "feng2015", "maeda2008", "shams2010"):
        data = study.read_claims(study.known_studies()[name] / "claims.toml")
        assert any(claim.without is not None for table in data.tables for claim in table.claims)


def test_scaled_values_reach_the_run(folder: Path, native: Path) -> None:
    run = Run("stage.toml", {"plant.command": 12.0}, 0.05, scaled={"plant.m": 2.0, "plant.F_C": 0.5})
    system = study.run_system(folder, run, native)
    start = next(instance for instance in system.instances if instance.name == "plant").start
    assert (start["m"], start["F_C"], start["command"]) == (124.8, 3.12, 12.0)
    with pytest.raises(DescriptionError, match=r"stage\.toml: there is no plant\.mass to be scaled"):
        study.run_system(folder, dataclasses.replace(run, scaled={"plant.mass": 2.0}), native)


def test_machines_are_the_same_every_time_and_their_quantiles_in_order(folder: Path, native: Path) -> None:
    run = Run(
        "stage.toml",
        {"plant.command": 12.0},
        measure=lambda result, window: {"speed": float(result["plant.speed"][-1])},
        machines=8,
        box={"plant.sigma_2": (0.5, 2.0), "plant.m": (0.8, 1.25)},
    )
    one, other = (study.run_one(folder, "m", run, native).numbers for _ in range(2))
    assert dict(one) == dict(other)
    assert one["failed"] == 0.0
    assert one["speed_median"] <= one["speed_p90"] <= one["speed_worst"]
    # (12 - F_C)/sigma_2 with sigma_2 of 0.2 to 0.8 N.m.s/rad
    assert 5.76 / 0.8 < one["speed_median"] < one["speed_worst"] < 5.76 / 0.2
