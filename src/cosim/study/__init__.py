"""Studies: runs that test the claims of a paper, and a verdict on each claim computed from the measured values.

A study is a folder ``studies/NAME`` with system files, a file of claims and a ``study.py`` that holds ``STUDY``, a
``Study``: its runs (name -> system file and changed values), its claims (``read_study``) and its pictures.
``cosim study NAME`` runs it and writes the report.
"""

from ..result.summary import tracking
from .claims import read_claims, read_study
from .rules import Criterion, Numbers, at_least, at_most, between, both, falling, near
from .run import find_study, known_studies, load_study, matching_runs, measure_run, run_one, run_study, run_system
from .study import (
    COPY,
    NONE,
    STATUSES,
    Claim,
    Kind,
    Measure,
    Missing,
    Outcome,
    Outcomes,
    Picture,
    Reading,
    Run,
    Status,
    Study,
    Value,
    Verdict,
    judge,
)

__all__ = [
    "COPY",
    "NONE",
    "STATUSES",
    "Claim",
    "Criterion",
    "Kind",
    "Measure",
    "Missing",
    "Numbers",
    "Outcome",
    "Outcomes",
    "Picture",
    "Reading",
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
    "read_claims",
    "read_study",
    "run_one",
    "run_study",
    "run_system",
    "tracking",
]
