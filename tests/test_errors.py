"""The hints in messages: which known name is meant."""

from __future__ import annotations

from cosim.errors import MOST_LISTED, suggest

MANY = {f"x_{n}": f"Value number {n}" for n in range(2 * MOST_LISTED)}


def test_the_nearest_name_is_meant() -> None:
    assert suggest("comand", ["command", "position"]) == " Did you mean 'command'?"


def test_a_word_of_the_meaning_is_meant() -> None:
    known = {**MANY, "m": "Moving mass of table", "sigma_0": "Stiffness of the bristles"}
    assert suggest("mass", known, known) == " Did you mean 'm' (Moving mass of table)?"
    assert suggest("bristle_stiffness", known, known) == " Did you mean 'sigma_0' (Stiffness of the bristles)?"


def test_a_word_of_many_meanings_says_too_little() -> None:
    assert suggest("value", MANY, MANY) == ""


def test_few_names_are_listed_many_are_not() -> None:
    assert suggest("q", ["b", "a"]) == " Known: a, b."
    assert suggest("q", MANY) == ""
