"""Sums and products of named values, as claims files and pictures write them.

    smc_5sin:error_max / csmc_5sin:error_max
    plant.position - trajectory.position

Operators ``+ - * /`` stand between spaces; ``*`` and ``/`` come before ``+`` and ``-``. A term is a number or a name.
A name may hold any character but a space.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, TypeVar

from ..errors import DescriptionError

T = TypeVar("T", float, Any)

SUMS: dict[str, Callable[[Any, Any], Any]] = {"+": operator.add, "-": operator.sub}
PRODUCTS: dict[str, Callable[[Any, Any], Any]] = {"*": operator.mul, "/": lambda one, other: one / other}


def names(text: str) -> list[str]:
    """The names in an expression, in their order. Raises DescriptionError if operators and terms do not alternate."""
    words = text.split()
    terms, operators = words[::2], words[1::2]
    if len(words) % 2 == 0 or any(word not in SUMS | PRODUCTS for word in operators):
        raise DescriptionError(f"'{text}' is not a sum or product of terms: write 'a / b', with spaces.")
    return [term for term in terms if not _is_number(term)]


def evaluate(text: str, lookup: Callable[[str], T]) -> T:
    """The value of an expression; ``lookup`` gives the value of a name. Raises DescriptionError as ``names`` does."""
    names(text)
    words = text.split()

    def value(term: str) -> Any:
        return float(term) if _is_number(term) else lookup(term)

    total: Any = None
    add = operator.add
    product = value(words[0])
    for sign, term in zip(words[1::2], words[2::2], strict=True):
        if sign in PRODUCTS:
            product = PRODUCTS[sign](product, value(term))
        else:
            total = product if total is None else add(total, product)
            add, product = SUMS[sign], value(term)
    return product if total is None else add(total, product)


def _is_number(term: str) -> bool:
    try:
        float(term)
    except ValueError:
        return False
    return True
