"""Temporal-logic semantics written from the textbook, and random formulas; shares no code with the package.

A formula is a nested tuple: ("atom", "a"), ("!", f), ("U", f, g), ("F", (a, b), f), ("X", f), ...; `text` writes it
with all parentheses. `holds` evaluates it on many words at once: on finite words (LTLf), or on lassos u v^omega.
"""

from __future__ import annotations

import itertools
import random
from typing import Any

import numpy as np

Tree = tuple[Any, ...]
BINARY = {"&", "|", "->", "<->", "U", "R", "W", "M"}


def text(f: Tree) -> str:
    if f[0] == "atom":
        return str(f[1])
    if f[0] in ("true", "false"):
        return str(f[0])
    if f[0] in BINARY:
        return f"({text(f[1])} {f[0]} {text(f[2])})"
    if len(f) == 3:
        low, high = f[1]
        bounds = f"{low}" if f[0] in ("X", "N") else f"{low},{high}"
        return f"({f[0]}[{bounds}] {text(f[2])})"
    return f"({f[0]} {text(f[1])})"


def all_words(n_propositions: int, length: int) -> np.ndarray:
    """All words: bool array (W, length, P)."""
    letters = list(itertools.product([False, True], repeat=n_propositions))
    words = list(itertools.product(letters, repeat=length))
    return np.array(words, dtype=bool).reshape(len(words), length, n_propositions)


def holds(f: Tree, words: np.ndarray, names: tuple[str, ...], loop: int | None = None) -> np.ndarray:
    """Whether each word satisfies `f`. With `loop`, the letters from position `loop` on repeat for ever."""
    return _values(f, words, names, loop)[:, 0]


def _values(f: Tree, words: np.ndarray, names: tuple[str, ...], loop: int | None) -> np.ndarray:
    """Truth at every position: bool array (W, length)."""
    length = words.shape[1]

    def of(g: Tree) -> np.ndarray:
        return _values(g, words, names, loop)

    def position(i: int, k: int) -> int | None:
        """The position k letters after i; None behind the end."""
        if i + k < length:
            return i + k
        return None if loop is None else loop + (i + k - loop) % (length - loop)

    def ahead(i: int, low: int, high: int) -> list[int]:
        found = [position(i, k) for k in range(low, high + 1)]
        return [p for p in found if p is not None]

    def every(columns: list[np.ndarray]) -> np.ndarray:
        return np.logical_and.reduce([np.ones(len(words), bool), *columns])

    def some(columns: list[np.ndarray]) -> np.ndarray:
        return np.logical_or.reduce([np.zeros(len(words), bool), *columns])

    op = f[0]
    if op == "atom":
        return words[:, :, names.index(f[1])]
    if op in ("true", "false"):
        return np.full(words.shape[:2], op == "true")
    if op == "!":
        return ~of(f[1])
    if op in ("&", "|", "->", "<->"):
        a, b = of(f[1]), of(f[2])
        return {"&": a & b, "|": a | b, "->": ~a | b, "<->": a == b}[op]
    result = np.zeros(words.shape[:2], dtype=bool)
    if op in ("X", "N"):
        k, a = (f[1][0], of(f[2])) if len(f) == 3 else (1, of(f[1]))
        for i in range(length):
            p = position(i, k)
            result[:, i] = a[:, p] if p is not None else op == "N"
        return result
    if op in ("F", "G"):
        (low, high), a = (f[1], of(f[2])) if len(f) == 3 else ((0, length), of(f[1]))
        for i in range(length):
            result[:, i] = (some if op == "F" else every)([a[:, p] for p in ahead(i, low, high)])
        return result
    a, b = of(f[1]), of(f[2])
    for i in range(length):
        path = ahead(i, 0, length)  # on a lasso every later position is met within `length` steps
        until = some([every([b[:, q]] + [a[:, p] for p in path[:k]]) for k, q in enumerate(path)])
        if op == "U":
            result[:, i] = until
        elif op == "W":
            result[:, i] = until | every([a[:, p] for p in path])
        elif op == "R":  # b up to and including the first a; for ever if there is none
            result[:, i] = every([some([b[:, q]] + [a[:, p] for p in path[:k]]) for k, q in enumerate(path)])
        else:  # M: the same, but there is an a
            release = every([some([b[:, q]] + [a[:, p] for p in path[:k]]) for k, q in enumerate(path)])
            result[:, i] = release & some([a[:, p] for p in path])
    return result


def random_formula(rng: random.Random, names: tuple[str, ...], depth: int) -> Tree:
    """Any formula of finite traces."""
    if depth == 0 or rng.random() < 0.1:
        return ("atom", rng.choice(names)) if rng.random() < 0.93 else (rng.choice(["true", "false"]),)
    op = rng.choice(["!", "X", "N", "F", "G", "F[]", "G[]", "X[]", "&", "|", "->", "<->", "U", "R", "W", "M"])
    if op in BINARY:
        return (op, random_formula(rng, names, depth - 1), random_formula(rng, names, depth - 1))
    body = random_formula(rng, names, depth - 1)
    if op in ("F[]", "G[]"):
        low = rng.randrange(3)
        return (op[0], (low, low + rng.randrange(3)), body)
    if op == "X[]":
        k = rng.randrange(4)
        return (rng.choice("XN"), (k, k), body)
    return (op, body)


def random_co_safe(rng: random.Random, names: tuple[str, ...], depth: int, positive: bool = True) -> Tree:
    """A syntactically co-safe formula; with `positive` False one whose negation is co-safe."""
    if depth == 0 or rng.random() < 0.1:
        return ("atom", rng.choice(names)) if rng.random() < 0.95 else (rng.choice(["true", "false"]),)

    def sub(sign: bool = positive) -> Tree:
        return random_co_safe(rng, names, depth - 1, sign)

    op = rng.choice(["!", "X", "F[]", "G[]", "&", "|", "->", "tt", "tt", "tt"])
    if op == "tt":
        op = rng.choice(["F", "U", "M"] if positive else ["G", "R", "W"])
    if op == "!":
        return ("!", sub(not positive))
    if op == "->":
        return ("->", sub(not positive), sub())
    if op in BINARY:
        return (op, sub(), sub())
    if op in ("F[]", "G[]"):
        low = rng.randrange(3)
        return (op[0], (low, low + rng.randrange(3)), sub())
    return (op, sub())
