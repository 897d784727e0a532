"""Short texts about the sizes of many agents, those that are alike counted together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from ....envs.systems.arguments import counted

MOST_SIZES = 3
"""Sizes that are written out: with their numbers of agents they fill about a line."""


def shape_text(shape: Sequence[int]) -> str:
    """Return numbers per axis as a product.

    Examples
    --------
    >>> shape_text((40, 20))
    '40 x 20'
    """
    return " x ".join(str(n) for n in shape)


def alike_text(texts: Iterable[str]) -> str:
    """Return texts, one per agent, with the number of agents that share each.

    Examples
    --------
    >>> alike_text(["500"]), alike_text(["500", "500"]), alike_text(["40 x 20", "500", "500"])
    ('500', '500 each', '500 (2 agents), 40 x 20 (1 agent)')
    """
    numbers = Counter(texts)
    if len(numbers) == 1:
        ((text, n),) = numbers.items()
        return text if n == 1 else f"{text} each"
    listed = [f"{text} ({counted(n, 'agent')})" for text, n in numbers.most_common(MOST_SIZES)]
    return ", ".join(listed) + (", ..." if len(numbers) > MOST_SIZES else "")
