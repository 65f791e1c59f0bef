"""Studies: the runs behind a paper, what it claims, what was measured, and a verdict computed from both.

A study is a folder ``studies/NAME`` with system files and a ``study.py`` that holds ``STUDY``, a ``Study``.
"""

from ..result.summary import tracking
from .rules import Numbers, Rule, at_least, at_most, between, both, falling, near
from .run import find_study, known_studies, load_study, matching_runs, measure_run, run_one, run_study
from .study import NONE, Claim, Missing, Outcome, Outcomes, Picture, Run, Status, Study, Value, Verdict, judge

__all__ = [
    "NONE",
    "Claim",
    "Missing",
    "Numbers",
    "Outcome",
    "Outcomes",
    "Picture",
    "Rule",
    "Run",
    "Status",
    "Study",
    "Value",
    "Verdict",
    "at_least",
    "at_most",
    "between",
    "both",
    "falling",
    "find_study",
    "judge",
    "known_studies",
    "load_study",
    "matching_runs",
    "measure_run",
    "near",
    "run_one",
    "run_study",
    "tracking",
]
