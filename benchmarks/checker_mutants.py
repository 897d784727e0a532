"""Who notices one wrong line of the checker? Its tests are run against copies of it with a line each that is sabotaged.

``python benchmarks/checker_mutants.py [--only WORD] [--missing] [--survivors]`` writes ``docs/checker_mutations.json``
and the table in ``docs/checker_mutations.md``. In each copy the tests of ``tests/checker`` that are about the sabotaged
file are run first, up to the first failure; then all others, the thorough ones last.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
TESTS, PACKAGE = ROOT / "tests" / "checker", ROOT / "src" / "certigym"
RECORD, PAGE = ROOT / "docs" / "checker_mutations.json", ROOT / "docs" / "checker_mutations.md"


class Mutant(NamedTuple):
    """A sabotage: in a file of the checker the first ``old`` becomes ``new``."""

    file: str
    old: str
    new: str


def _in(file: str, *pairs: tuple[str, str]) -> list[Mutant]:
    return [Mutant(file, old, new) for old, new in pairs]


MUTANTS = [
    *_in(
        "rigorous",
        ("EXP_ERROR, SIN_ERROR = 32 * U, 24 * U", "EXP_ERROR, SIN_ERROR = U / 8, 24 * U"),
        ("EXP_ERROR, SIN_ERROR = 32 * U, 24 * U", "EXP_ERROR, SIN_ERROR = 32 * U, U / 64"),
        ("(1.0 + 2.0**-9 * np.abs(k))", "0.001"),
        ("for n in range(16, 0, -1):", "for n in range(9, 0, -1):"),
        ("r = r - k * HALF_PI[2]", "r = r + k * HALF_PI[2]"),
        ("for n in range(11, 0, -1):", "for n in range(6, 0, -1):"),
        ("(k + quarters) % 4", "k % 4"),
        ("np.where(rising(low)[1] <= x, low, np.nan)", "low"),
        ("guess - radius, guess + radius", "guess, guess + radius"),
        ("beyond = np.where(np.isnan(x), np.nan, 1.0)", "beyond = 0.5"),
        ("sign * 1.57075 + 5e-5", "sign * 1.57075 - 4e-5"),
        ("sign * 1.57075 - 5e-5", "sign * 1.57075 + 4e-5"),
        ("np.minimum((high - 1) / (high + 1) + 4 * U, 1.0)", "np.minimum((high - 1) / (high + 1) - 4 * U, 1.0)"),
        ("PHI_0 = (0.39894228040143267, 0.39894228040143271)", "PHI_0 = (0.39894228040143271, 0.39894228040143267)"),
        ("((1.0 + off) * square + 8.0) * U", "0.0 * U"),
        ("((1.0 + off) * square + 8.0) * U", "-(9e5 * square + 8.0) * U"),
        ("_convergent(z[at], count + 1)", "_convergent(z[at], count)"),
        (
            "((SERIES_END, 3.0, 100), (3.0, 6.0, 40), (6.0, np.inf, 16))",
            "((SERIES_END, 3.0, 100), (3.0, 6.0, 40), (6.1, np.inf, 16))",
        ),
        ("for n in range(1, 32):", "for n in range(1, 12):"),
        ("np.full((2, *z.shape), np.nan)", "np.zeros((2, *z.shape))"),
    ),
    *_in(
        "intervals",
        ("return np.nextafter(x, -np.inf)", "return np.asarray(x)"),
        ("return np.nextafter(x, np.inf)", "return np.asarray(x)"),
        ("return -a[::-1]", "return -a"),
        ("a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1]", "a[0] * b[0], a[0] * b[1], a[0] * b[1], a[1] * b[1]"),
        ("low = np.where((a[0] >= 0) & (b[0] >= 0), np.maximum(low, 0.0), low)", "low = np.maximum(low, 0.0)"),
        ("error, empty = (n + 2) * U * size, size == 0", "error, empty = 0.0 * size, size == 0"),
        ("apart = (a[0] > 0) | (a[1] < 0)", "apart = (a[0] >= 0) | (a[1] <= 0)"),
        ("low = np.where((a[0] <= 0) & (a[1] >= 0), 0.0,", "low = np.where((a[0] < -1) & (a[1] >= 0), 0.0,"),
        ("up(size.max(axis=0) ** 2)", "up(a[1] ** 2)"),
        ("r = np.sqrt(np.where(a[0] >= 0, a, np.nan))", "r = np.sqrt(np.maximum(a, 0.0))"),
        ("(np.where(a[0] > 0, a, np.nan))\n\n\nLARGEST", "(np.maximum(a, 1e-300))\n\n\nLARGEST"),
        ("for _ in range(int(p) // 2):", "for _ in range((int(p) - 1) // 2):"),
        ("np.where(bottom, -1.0, np.maximum(low, -1.0))", "np.maximum(low, -1.0)"),
        ("for place in (0.25, 0.75)", "for place in (0.75, 0.25)"),
        ("turns = a / (2 * np.pi) + 0.25 * quarters", "turns = a / (2 * np.pi)"),
        ("np.where(top, 1.0, np.minimum(high, 1.0))", "np.minimum(high, 1.0)"),
        ("np.where(between & known(a), np.stack([low[0], high[1]]), np.nan)", "np.stack([low[0], high[1]])"),
    ),
    *_in(
        "jets",
        ("value = np.where(known(self.value), value, np.nan)", "value = value + 0.0"),
        ("value = np.where(known(a) & known(b), mul(a, b), np.nan)", "value = mul(a, b)"),
        (
            "add(mul(first[:, None, None], self.bend), mul(second[:, None, None], outer))",
            "mul(first[:, None, None], self.bend)",
        ),
        ("bend = add(bend, add(outer, outer.swapaxes(1, 2)))", "bend = add(bend, outer)"),
        (
            "slope = add(mul(a[:, None], other.slope), mul(b[:, None], self.slope))",
            "slope = mul(a[:, None], other.slope)",
        ),
        (
            '"sin": (sine, lambda a, f: sine(a, 1), lambda a, f, d: neg(f))',
            '"sin": (sine, lambda a, f: sine(a, 1), lambda a, f, d: f)',
        ),
        ("lambda a, f: neg(sine(a)), lambda a, f, d: neg(f)", "lambda a, f: sine(a), lambda a, f, d: neg(f)"),
        ("mul(mul(TWO, f), d)", "mul(f, d)"),
        ("add(ONE, neg(square(f)))", "add(ONE, square(f))"),
        ("lambda a, f, d: neg(square(d))", "lambda a, f, d: square(d)"),
        ("neg(mul(d, recip(add(a, a))))", "neg(mul(d, recip(a)))"),
        ("mul(TWO, power(f, 3.0))", "power(f, 3.0)"),
        ("mul(mul(-TWO, a), square(d))", "mul(mul(-TWO, a), d)"),
        ("np.where(right & ~left, 1.0, -1.0)", "np.where(right, 1.0, -1.0)"),
        ("np.where(d[0] == d[1], 0.0, np.nan)", "np.where(d[0] == d[1], 0.0, 0.0)"),
        ("first, second = first & ~second, second & ~first", "first, second = first, second"),
        ("np.where(first, a.bend, np.where(second, b.bend, np.nan))", "np.where(first, a.bend, b.bend)"),
        ("np.where(first, a.slope, np.where(second, b.slope, hull))", "np.where(first, a.slope, b.slope)"),
        ("first if (p - 1.0) + 1.0 == p else unknown", "first"),
        ("mul(mul(_number(p), _number(p - 1.0)), raised(p - 2.0))", "mul(_number(p), raised(p - 2.0))"),
        (
            "add(at_centre, mul(half, quadratic(around.bend, box)))",
            "add(at_centre, mul(_number(0.25), quadratic(around.bend, box)))",
        ),
        ("total(mul(add(around.slope, neg(row)), box), 0)", "total(mul(add(centre.slope, neg(row)), box), 0)"),
        (
            "at_centre = total(mul(add(centre.slope, neg(row)), box), 0)",
            "at_centre = 0.0 * total(mul(add(centre.slope, neg(row)), box), 0)",
        ),
        ("add(bounded(middle), quadratic(add(around.bend, -interval(middle)), box))", "bounded(middle)"),
        ("forms.append(add(at_centre, mul(half, curve)))", "forms.append(add(at_centre, mul(half, 0.5 * curve)))"),
        ("np.where(known(around.value), form, np.nan)", "form"),
        ('return -a if name == "negative" else', 'return a if name == "negative" else'),
        ("return a + (-b)", "return a + b"),
        ("else -_maximum(-a, -b)", "else _maximum(a, b)"),
        ("ranges = add(interval(point), box)[..., None]", "ranges = add(interval(point), 0.5 * box)[..., None]"),
        ("interval(np.full(1, float(t)))", "interval(np.full(1, float(t) - 1.0))"),
        ("matrix[p, free:] = 0.0", "pass"),
        ("if not np.all(np.isfinite(row)) or not np.all(np.isfinite(own)):", "if False:"),
        ("add(centre.value, off_linear(", "add(0.0 * centre.value, off_linear("),
    ),
    *_in(
        "automaton",
        ("if known.get(p, True):", "if known.get(p, False):"),
        ("if not known.get(p, False):", "if not known.get(p, True):"),
        ("done = automaton.is_co_safe and automaton.accepting[q]", "done = False"),
        ("self.variable[child] <= p", "self.variable[child] < p"),
        ("any(not -states <= entry < nodes", "any(not -states - 1 <= entry < nodes"),
        ("targets & alive}", "targets <= alive}"),
    ),
    *_in(
        "formula",
        (
            "if automaton.is_co_safe and automaton.accepting[automaton.initial] and progression.now(formula) != 1:",
            "if False:",
        ),
        ("f == 1 if automaton.is_co_safe else progression.holds_at_end(f)", "progression.holds_at_end(f)"),
        ("if pair in seen or dead[q]:", "if pair in seen or dead[q] or len(seen) > 3:"),
        ('self.ite(self.now(a), self.variable(("X", f)), 0)', 'self.variable(("X", f))'),
        ("f = self.nodes[f][1]", "f = self.nodes[f][2]"),
        ('return self.ite(self.variable(("X", ("!", a))), 0, 1)', 'return self.variable(("X", a))'),
        ('("U", b, ("&", a, b))', '("U", b, a)'),
        ('("!", ("U", ("!", b), ("&", ("!", a), ("!", b))))', '("!", ("U", ("!", b), ("!", a)))'),
        ("max(low - 1, 0), high - 1", "max(low - 1, 0), high"),
        ("self.ite(self.now(a), 1, later)", "later"),
        ('"->": (y, 1)', '"->": (y, 0)'),
        ("(own, depth + 1) if own in (2, 5) else (own + 1, depth)", "(own, depth)"),
        ("sorted(bounds) != bounds", "False"),
        ("if f not in self.variables:\n                raise Refused", "if False:\n                raise Refused"),
        ("f != 1 and not (automaton.is_co_safe and automaton.accepting[q])", "f != 1 and not automaton.accepting[q]"),
        ("here = entry >= 0 and automaton.variable[entry] == p", "here = entry >= 0"),
    ),
    *_in(
        "letters",
        ("np.any((region.high[t] <= o.low[t]) | (o.high[t] <= region.low[t]))", "np.any(region.low[t] <= o.low[t])"),
        ("if value == 1 and o.agents == region.agents", "if value == 1"),
        ("if value in (-1, 1)}", "if value}"),
        (
            "Fraction(a_low) - Fraction(b_high), Fraction(a_high) - Fraction(b_low)",
            "Fraction(a_low) - Fraction(b_low), Fraction(a_high) - Fraction(b_high)",
        ),
        ("most * spare < radius * radius", "least * spare < radius * radius"),
        ("divmod(int(faces[t, p]), 2)", "divmod(int(faces[t, p]) ^ 1, 2)"),
        ("limits[k][above]", "limits[k][1 - above]"),
        (
            "zip(own.agents, own.outputs, (1.0, -1.0), strict=False)",
            "zip(own.agents[::-1], own.outputs, (1.0, -1.0), strict=False)",
        ),
        ("0.9238795325112867 if count == 2", "1.0 if count == 2"),
        ("else 1.0 / float(np.sqrt(count))", "else 1.0"),
        ("0.25 * np.pi * np.arange(4)", "0.25 * np.pi * np.arange(3)"),
        ("np.maximum(normal * low, normal * high)", "normal * low"),
        (
            "largest = radius * float(np.sqrt(np.sum(normal * normal)))",
            "largest = radius * float(np.max(np.abs(normal)))",
        ),
        ("if not np.any(normal) or not np.isfinite(largest):", "if False:"),
        ("first, last = last, last + len", "first, last = 0, last + len"),
        ("elif value == -1 and np.all(own.low[t] < own.high[t]):", "elif False:"),
        ("if not np.all(np.isfinite([first, second])):", "if False:"),
    ),
    *_in(
        "motions",
        ("holds = (a <= least)", "holds = (a <= most)"),
        ("np.where(reached, most < a, most <= a)", "np.where(reached, least < a, most <= a)"),
        ("if np.any(inputs < agent.input_box[0]) or np.any(inputs > agent.input_box[1]):", "if False:"),
        ("matrix[:, :d]", "2.0 * matrix[:, :d]"),
        ("rho = up(np.maximum(ends[1] - z, z - ends[0]))", "rho = 0.5 * up(np.maximum(ends[1] - z, z - ends[0]))"),
        ("rho += 2 * U *", "rho += 0 * U *"),
        (
            "box = np.stack([down(ranges[0] - middle), up(ranges[1] - middle)])",
            "box = 0.5 * np.stack([down(ranges[0] - middle), up(ranges[1] - middle)])",
        ),
        ("getattr(others[j], boxes)[:, k] for", "np.full(2, getattr(others[j], boxes)[:, k].mean()) for"),
        ("dict[str, Any](agent.disturbances)", "{k: (v[0], v[0]) for k, v in agent.disturbances.items()}"),
        ('if "t" in names_in(agent.dynamics) -', 'if "t" in set() -'),
        (
            "wrong = np.argwhere((u - spread < agent.input_box[0]) | (u + spread > agent.input_box[1]))",
            "wrong = np.argwhere((u < agent.input_box[0]) | (u > agent.input_box[1]))",
        ),
        ("missed = np.abs(B @ inverse - np.eye(d)) + (m + 2.0)", "missed = (m + 2.0)"),
        ("np.maximum(np.abs(low), np.abs(high)) @ np.abs(A).T + np.abs(b)", "np.abs(b)"),
        ('if terms is None or [name for _, name in terms].count("") > 1:', "if terms is None:"),
        ("rest = size @ missed.T + rounding @ np.abs(B).T", "rest = 0.0 * size @ missed.T"),
        ("last = high == np.array([axis[-1] for axis in edges])", "last = high != high"),
        ("np.where(reached, most < b, most <= b)", "(most <= b)"),
        ("np.where(reached, most < a, most <= a)", "(most <= a)"),
        ("| (b <= least)", "| (b <= most)"),
        ("np.where(holds.all(axis=0), 1, 0)", "1"),
        ("if np.any(region.low != region.low[0]) or np.any(region.high != region.high[0]):", "if False:"),
        ("if region.agents == (i,)]", "if True]"),
        ("return ends[0], ends[1], reached", "return ends[0], ends[0], reached"),
    ),
    *_in(
        "angles",
        ("repeat = [*agent.scale, *(tree for tree in agent.outputs if tree != angle)]", "repeat = []"),
        ("[*agent.scale, *(tree", "[*(tree"),
        ("or (slope and name not in agent.angles)", ""),
        ("slope.denominator != 1", "False"),
        ("any(_slope(tree, named) != 0 for other in problem.agents for tree in other.dynamics)", "False"),
        ("if compared & set(agent.angle_outputs):", "if False:"),
        ("low, high = high, low + TURN", "low, high = high, low + 2 * TURN"),
        ("low, high = max(low, first), min(high, last)", "pass"),
        ("turns = round(", "turns = int("),
        ("return Fraction(0) if (2 * a if", "return Fraction(0) if True or (2 * a if"),
        ('return a + b if name == "+" else a - b', "return a + b"),
        ("return a if a == b else None", "return a"),
        ("if not abs(value) <= FARTHEST:", "if False:"),
        ("elif high - low >= TURN - OFF:", "elif high - low >= 1.0:"),
    ),
    *_in(
        "letters",
        ("not _one_window(letters, faces, t - 1, p), not _one_window", "t == 1, not _one_window"),
        ("and faces[t, p] == faces[t + 1, p]", ""),
        (
            "keeps_low, keeps_high = (first, last) if from_above else (last, first)",
            "keeps_low, keeps_high = last, first",
        ),
        (
            "low if j != k or keeps_low else -np.inf, high if j != k or keeps_high else np.inf",
            "low if j != k or keeps_low else -np.inf, np.inf",
        ),
        ("low if j != k or keeps_low else -np.inf,", "low if keeps_low else -np.inf,"),
        ("region.high[t, k] - region.low[t - 1, k]", "region.high[t, k] - region.low[t, k]"),
        ("region.low[t, k] - region.high[t - 1, k]", "region.low[t - 1, k] - region.high[t - 1, k]"),
        ("(least, np.inf) if from_above else (-np.inf, most)", "(-np.inf, np.inf) if from_above else (-np.inf, most)"),
        ("if ends <= now:", "if True:"),
        (
            "set()).update(followed(automaton, states, known))",
            "set()).update({min(followed(automaton, states, known))})",
        ),
        ("if not automaton.is_co_safe and len(letters) != problem.horizon + 1:", "if False:"),
        ("after.setdefault(now - ends, set())", "after.setdefault(now, set())"),
        ("if len(letters) > problem.horizon + 1:", "if len(letters) > problem.horizon + 2:"),
        ("if not all(automaton.accepting[q]", "if not any(automaton.accepting[q]"),
        ("or k in problem.agents[region.agents[0]].angle_outputs", ""),
    ),
    *_in(
        "constraints",
        ("strips = np.minimum(2.0 * tails(", "strips = np.minimum(1.0 * tails("),
        ("tails(np.minimum(low, high), variance), 1.0)", "tails(np.maximum(low, high), variance), 1.0)"),
        ("np.where(self._kinds(sources) == NORMAL, strips, 1.0)", "strips"),
        ("self.first.append(each.sum(axis=0))", "self.first.append(each.max(axis=0))"),
        ("normal = np.flatnonzero(kinds == NORMAL)", "normal = np.arange(len(kinds))"),
        ("(ends[:, normal], forms.at(normal))][-EARLIER:]", "(ends, forms)][-EARLIER:]"),
        ("np.maximum(2.0 * np.abs(earlier.moved) - earlier.size, 0.0)", "2.0 * earlier.size"),
        ("rho = (np.abs(covariance) - off) /", "rho = 1.05 * (np.abs(covariance) - off) /"),
        ("(covariance > 0.0) == bool(side)", "(covariance > 0.0) != bool(side)"),
        ("before[1], before[0]) / least", "before[1], before[0]) * 0.9 / least"),
        ("a = end[:, None] / own * (1.0 - 8.0 * U)", "a = end[:, None] / own * 1.01"),
        ("below[:, -1] * tail[:, -1]", "0.0 * tail[:, -1]"),
        ("mean = np.where(chord, 0.5 * (tail[:, :-1] + tail[:, 1:]), tail[:, :-1])", "mean = tail[:, 1:]"),
        ("chord = (y[:, 1:] >= 0.0) & (c[:, :-1] >= 0.0)", "chord = y[:, 1:] > -9.0"),
        ("(_union(np.array(each)) + self.lost)", "_union(np.array(each))"),
        ("_union(np.array(each))", "float(np.max(each))"),
        ("component[members] = component[members].min()", "pass"),
        (
            "np.where(sources, self.kinds, NORMAL).max(axis=1, initial=NORMAL)",
            "np.where(sources, self.kinds, NORMAL).min(axis=1, initial=LIGHT)",
        ),
        ("np.where(np.isnan(sides), -np.inf, sides)", "np.where(np.isnan(sides), np.inf, sides)"),
        ("each = np.where(ends < 0.0, 1.0, known)", "each = np.stack(known)"),
        ("(np.where(some >= 0.0, some, np.nan) for some in (ends, before))", "(ends, before)"),
        ("np.minimum(2.0 * normal, light)", "np.minimum(normal, light)"),
        ("z = np.where(np.isnan(variance), -np.inf, distance) / np.sqrt(variance)", "z = distance / variance"),
        (
            "z = np.where(np.isnan(variance), -np.inf, distance) / np.sqrt(variance)",
            "variance = np.nan_to_num(variance)\n        z = distance / np.sqrt(variance)",
        ),
        ("np.where((distance > 0) & ~np.isnan(variance), np.inf, -np.inf)", "np.inf"),
        ("np.where(z >= 0, high, up(1.0 - low))", "high"),
        ("np.where(z >= 0, high,", "np.where(z >= 0, 0.999999999 * high,"),
        ("np.where(z == -np.inf, 1.0,", "np.where(z == -np.inf, 0.0,"),
        ("rigorous.exp(-0.5 * size * size", "rigorous.exp(-1.0 * size * size"),
        ("r = down(np.sqrt(1.0 + 2.0 * (size * size / n)", "r = down(np.sqrt(1.0 + 4.0 * (size * size / n)"),
        (
            "np.clip(np.nan_to_num(variance / largest, nan=1.0)",
            "np.clip(4.0 * np.nan_to_num(variance / largest, nan=1.0)",
        ),
        ("[normal, stopped, light], long)", "[normal, stopped, light], light)"),
    ),
    *_in(
        "error_system",
        ("largest = float(np.max(np.sum(np.abs(found) + off, axis=1)))", "largest = 0.5"),
        ("known = np.max(off.sum(axis=1)) <= 1e-3", "known = True"),
        (" or kind > LIGHT:", ":"),
        ("total = 2.0 * float(rigorous.tail(", "total = float(rigorous.tail("),
        ("term *= x / (k + 1.0 + half)", "term *= x / (k + 1.0)"),
        ("up_to = np.maximum(sign * values, 0.0)", "up_to = 0.5 * np.maximum(sign * values, 0.0)"),
        ("length * up_to.max(axis=1) + 2.0 *", "length * up_to.max(axis=1) + 0.0 *"),
        ("total += np.sum(up_to * beside**2, axis=1) + (", "total += ("),
        ("np.where(np.outer(seen, seen), 0.0, M)", "0.0 * M"),
        ("spare = off @ size @ (2.0 * far + off) + (", "spare = ("),
        (
            "self.products = np.concatenate([np.matmul(matrix, self.products)",
            "self.products = np.concatenate([np.matmul(matrix.T, self.products)",
        ),
        (
            "spare = (np.abs(y[0]) + (d + 2.0) * U * most[0]) @ self.spread * counted",
            "spare = 0.0 * np.abs(y[0]) @ self.spread",
        ),
        ('spare = spare + np.einsum("sjd,sd->j", missed, reach) * counted', "spare = spare + 0.0"),
        (
            "missed = np.abs(np.matmul(after, matrices) - before)",
            "missed = 0.0 * np.abs(np.matmul(after, matrices) - before)",
        ),
        ("before[-1] -= earlier", "before[-1] += earlier"),
        ("y[:-1] += np.matmul(earlier[None], self.before)", "y[:-1] -= np.matmul(earlier[None], self.before)"),
        ("0.5 * (pushed[:, 1] - pushed[:, 0])", "0.25 * (pushed[:, 1] - pushed[:, 0])"),
        ("0.5 * (pushed[:, 0] + pushed[:, 1])", "pushed[:, 0]"),
        ("np.sum(size * size, axis=2)", "np.sum(moved, axis=2)"),
        ("each.sum(axis=0) * more", "each.max(axis=0) * more"),
        ("each.max(axis=0) * more", "each.mean(axis=0) * more"),
        ("np.any(size > 0.0, axis=0)", "np.all(moved > 0.0, axis=0)"),
        ("np.where(moved != 0.0, 1e-160, 0.0)", "0.0"),
        ("self._moved(y[1:], most[1:])", "self._moved(y[:-1], most[1:])"),
    ),
    *_in(
        "steps",
        ("if np.any(start[0] < box[0]) or np.any(start[1] > box[1]):", "if False:"),
        ("if np.any(point & (start[0] != states[0])):", "if False:"),
        (
            "np.where(point, 0.0, np.maximum(up(start[1] - states[0]), up(states[0] - start[0])))",
            "np.where(point, 0.0, 0.5 * up(start[1] - start[0]) * 0.9)",
        ),
        (
            "low, high = np.minimum(down(drift[0] - width), 0.0), np.maximum(up(drift[1] + width), 0.0)",
            "low, high = -0.5 * width, 0.5 * width",
        ),
        ("np.maximum(up(drift[1] + width), 0.0)", "np.maximum(up(width + 0 * drift[1]), 0.0)"),
        (
            "low = np.maximum(low, np.minimum(down(joint.box[0] - joint.states[t]), 0.0))",
            "low = np.maximum(low, np.minimum(0.5 * (joint.box[0] - joint.states[t]), 0.0))",
        ),
        ("if not np.all(np.abs(ends[:, joint.turning]) <= HALF_TURN):", "if False:"),
        ("rows[:, places] = part", "rows[:, places] = 0.0 * part"),
        ("((u < low) | (u > high)) & ~joint.networked", "((u < low) | (u > high)) & False"),
        ("joint.constraints.add(below, above, width[moved], forms.at(moved), labels)", "pass"),
        ("below, above = down(value[0] - low[moved])", "below, above = np.inf + down(value[0] - low[moved])"),
        ("width = joint.input_widths[t] if t else", "width = 0.3 * np.minimum(joint.input_widths[t], 1.0) if t else"),
        ("add(interval(u), np.stack([-rounding, rounding]))", "interval(u)"),
        (
            "deviation = np.stack([np.maximum(low_move, down(low - u)), np.minimum(high_move, up(high - u))])",
            "deviation = 0.3 * np.stack([low_move, high_move])",
        ),
        (
            "add(add(ends, neg(interval(joint.states[t + 1, here]))), mean)",
            "add(ends, neg(interval(joint.states[t + 1, here])))",
        ),
        ("neg(interval(joint.states[t + 1, here]))", "neg(interval(joint.states[t, here]))"),
        ("on_tube, own = add(interval(point), box)", "on_tube, own = interval(point)"),
        (
            "joint.errors.step(matrix, pushed, np.abs(tube.ends).max(axis=0), noise, off)",
            "joint.errors.step(matrix, pushed, 0.0 * np.abs(tube.ends).max(axis=0), noise, off)",
        ),
        (
            "columns.index(slices[j].start + k) for name, (j, k) in states.items()",
            "columns.index(slices[j].start) for name, (j, k) in states.items()",
        ),
        ("own.gains[t] if own.network is None", "own.gains[0] if own.network is None"),
        ("[inputs_at[j].start + k for j, k in inputs.values()]", "[inputs_at[i].start for j, k in inputs.values()]"),
        ("middle = 0.5 * reads.ranges[0] + 0.5 * reads.ranges[1]", "middle = reads.ranges[0]"),
        (
            "np.stack([down(reads.ranges[0] - middle), up(reads.ranges[1] - middle)])",
            "0.5 * np.stack([down(reads.ranges[0] - middle), up(reads.ranges[1] - middle)])",
        ),
        ("np.concatenate([np.zeros(n), rounding, np.zeros(len(point) - n - m)])", "np.zeros(len(point))"),
        ("spare = (spare + np.abs(B) @ rounding) * ROUNDED + 1e-290", "spare = 0.0 * spare"),
        ("return A + B @ gains,", "return A,"),
    ),
    *_in(
        "trajectories",
        (
            "width = np.concatenate([joint.widths[t], np.full(len(first) - D, np.inf)])",
            "width = np.full(len(first), np.inf)",
        ),
        ("np.minimum.at(ends[side], own, room[side])", "ends[side][own] = room[side]"),
        ("for side in (0, 1):", "for side in (1,):"),
        (
            "room = np.stack([down(value[0] - low), down(high - value[1])])",
            "room = np.stack([down(value[1] - low), down(high - value[0])])",
        ),
        ("values], axis=1), drift[:, own])", "values], axis=1), 0.0 * drift[:, own])"),
        ("joint.errors.rows(new, -old)", "joint.errors.rows(new, old)"),
        ("add(now, neg(was))", "now"),
        ("add(values[:, n], mul(interval(factor), ends))", "add(values[:, n], ends)"),
        ("rows[n] += factor * row", "rows[n] += row"),
        ("joint.constraints.lost += given_up", "joint.constraints.lost += 0.0 * given_up"),
        ("if before is not None:", "if before is not None and tube.t > 1:"),
        ("asked += crossed(problem, proof.letters, proof.faces, tube.t)", "asked += []"),
        ("_ask_jumps(joint, before, tube,", "_ask_jumps(joint, tube, tube,"),
        ("check_words(problem, proof.letters, proof.faces)", "pass"),
        ("check_angles(problem)\n    check_words", "check_words"),
    ),
    *_in(
        "constraints",
        (
            "size = factor.copy(), np.zeros(factor.shape), up(np.abs(ends).max",
            "size = factor.copy(), np.zeros(factor.shape), up(np.abs(ends).min",
        ),
        ("own = slice(0, factor.shape[1] - agent.shared_noise.shape[1])", "own = slice(0, factor.shape[1])"),
        ("if _varies(agent) and np.any((factor", "if False and np.any((factor"),
        ("np.where(ends.sum(axis=0)[:, None] < 0.0, -size, size)", "size"),
        ("if not _varies(agent):", "if False:"),
        (
            "down(own.mean - np.full(len(column), own.off)), up(own.mean + own.off + 0.0 * column)",
            "own.mean + 0.0 * column, own.mean + 0.0 * column",
        ),
        ("mul(ends, mean_of(agent))", "mean_of(agent)"),
        ("STOPPED if stopped else envelope.tail", "envelope.tail"),
        ("_varies(agent) and np.any(column != 0.0)", "_varies(agent) and np.all(column != 0.0)"),
        ("{*agent.states, *agent.inputs, *agent.disturbances}", "{*agent.states, *agent.inputs}"),
    ),
    *_in(
        "problem",
        ("agent.noise * np.array([envelope.deviation for", "agent.noise * np.array([envelope.deviation**2 for"),
        ("factor[here, shared:] = agent.shared_noise", "pass"),
        ("factor[here, own] = agent.noise", "factor[here, sources[0]] = agent.noise"),
        ("if not TURN - 1e-13 <= high - low <= TURN or abs(low) > 7.0:", "if False:"),
        ("if first == second:", "if False:"),
        (
            '{f"{name}.{key}": (j, k) for k, key in enumerate(own_names)}',
            '{f"{name}.{key}": (i, k) for k, key in enumerate(own_names)}',
        ),
        ("if np.any(workspace[0] >= workspace[1]):", "if False:"),
    ),
    *_in(
        "distributions",
        ("0.5 * (b - a) / math.sqrt(3.0))", "0.5 * (b - a) / 3.0)"),
        ("half / math.sqrt(6.0) if even else half", "half / math.sqrt(6.0)"),
        ('_positive(b, "scale") * math.sqrt(2.0)', '_positive(b, "scale")'),
        ('_positive(s, "scale") * LOGISTIC', '_positive(s, "scale")'),
        ("* LOGISTIC * OUTWARD, LONG)", "* LOGISTIC * OUTWARD, NORMAL)"),
        ("half = 0.5 * (max(means) - min(means)) + off", "half = off"),
        ("max(part.deviation for part in parts)", "min(part.deviation for part in parts)"),
        ("(low + mode + high) / 3.0", "(low + high) / 2.0"),
        ("mean = sum(weight / sum(weights) * own", "mean = sum(own / len(means)"),
        ('_positive(std, "std", 0.0), NORMAL)', '_positive(std, "std", 0.0) ** 2, NORMAL)'),
        ("half / math.sqrt(6.0) if even else half)", "half / math.sqrt(6.0))"),
        (
            'min(_positive(spread, "spread"), _positive(high, "high"))',
            '0.5 * min(_positive(spread, "spread"), _positive(high, "high"))',
        ),
        ("math.sqrt(2.0 * most) * OUTWARD, LONG, lost)", "math.sqrt(2.0 * most) * OUTWARD, LONG)"),
        (
            "most = max(most, (share / math.factorial(2 * j)) ** (1.0 / j))",
            "most = (share / math.factorial(2 * j)) ** (1.0 / j)",
        ),
    ),
    *_in(
        "distributions",
        ("FAR, FAR_TAIL, FAR_DENSITY = 10.0,", "FAR, FAR_TAIL, FAR_DENSITY = 5.0,"),
        ("x = (edges - points[:, None]) / deviation", "x = (edges - points[:, None]) / deviation**2"),
        ("np.maximum(low - U, 0.0), high + U", "low + 4 * U, high + 4 * U"),
        (
            "mass = np.maximum(np.where(on_right, from_right, from_left), 0.0)",
            "mass = np.maximum(np.where(on_right, from_right, from_left)[[1, 1]], 0.0)",
        ),
        ("on_right = x[:, :-1] + x[:, 1:] > 0", "on_right = x[:, :-1] + x[:, 1:] > -9e9"),
        ("float(np.max(np.sum(mass[1] - mass[0], axis=1))) * 1.001", "0.0"),
        ("np.stack([falling, rising], axis=-1)", "np.stack([rising, falling], axis=-1)"),
        ("falling = np.clip(add(mass, neg(rising)), 0.0, None)", "falling = mass"),
        (
            "if not (np.all(np.greater(deviation, 0) & np.less(deviation, np.inf)) and np.all(np.diff(edges) > 0)):",
            "if False:",
        ),
    ),
    *_in(
        "cells",
        (
            "FOURTH, CROSSED, DENSITY = 1.40031, 0.46840, 0.39895",
            "FOURTH, CROSSED, DENSITY = 0.40031, 0.46840, 0.39895",
        ),
        (
            "FOURTH, CROSSED, DENSITY = 1.40031, 0.46840, 0.39895",
            "FOURTH, CROSSED, DENSITY = 1.40031, 0.46840, 0.19895",
        ),
        ("np.sum(FOURTH * ratios**4 / 96.0) + np.sum(crossed)", "np.sum(crossed)"),
        ("(1.0 + 0.5 * d) * (uneven + rounded) + rounded", "0.0"),
        ("self.lack * (1.0 + 0.25 * d)", "0.0"),
        ("np.where(tensor < NOTHING, 0.0, tensor *", "np.where(tensor < NOTHING, 0.0, 1.0001 * tensor *"),
        ("LOOK, BESIDE = 0.37, 1.63", "LOOK, BESIDE = -3.0, 0.0"),
        (
            "off = float(np.sum(self.target_rest * DENSITY / self.deviations))",
            "off = 0.0 * float(np.sum(self.target_rest * DENSITY / self.deviations))",
        ),
        ("np.flatnonzero((policy >= 0) & (policy < self.inputs))", "np.flatnonzero(policy < self.inputs)"),
        (
            "below = np.maximum(at.min(axis=2) - lacking, 0.0)[:, :, None]",
            "below = np.maximum(at.mean(axis=2) - lacking, 0.0)[:, :, None]",
        ),
        ("below = np.maximum(at.min(axis=2) - lacking, 0.0)", "below = np.maximum(at.min(axis=2), 0.0)"),
        ("result[:, some] = below * inside[:, None]", "result[:, some] = below"),
        ("cells * self.inputs + choices", "cells * self.inputs"),
        ("moved = G * self._half(cells)[:, None, :]", "moved = 0.5 * G * self._half(cells)[:, None, :]"),
        (
            "position, rest = (z - first) / self.spacing, rho / self.spacing * (1.0 + 4.0 * U)",
            "position, rest = (z - first) / self.spacing, 0.0 * rho",
        ),
        ("np.where(steps < 1.0, steps / 4.0, (steps * steps + 1.0) / 8.0)", "0.0 * steps"),
        ("weights = [bends[:, k] + 0.125 for k in range(d)]", "weights = [bends[:, k] for k in range(d)]"),
        ("(steps[:, i] * steps[:, j]).sum(axis=1) / 4.0", "0.0 * steps[:, i].sum(axis=1)"),
        ("weights += [rest[:, k] for k in range(d)]", "weights += [0.0 * rest[:, k] for k in range(d)]"),
        ("np.repeat(self.slack * largest[:, None], len(cells), axis=1)", "np.zeros((len(largest), len(cells)))"),
        ("lacking += weight * table[(slice(None), *looked)]", "lacking = lacking"),
        ("np.maximum(np.diff(values, 2, axis=k), 0.0)", "np.maximum(-np.diff(values, 2, axis=k), 0.0)"),
        ("np.maximum(best[:-k], wide[k:], out=best[:-k])", "pass"),
        ("[0, *(axis for k in range(d) for axis in (1 + k, 1 + d + k))]", "[0, *range(1, 2 * d + 1)]"),
        ("share, flat = position - base,", "share, flat = 0.0 * position,"),
        ("sure.min(axis=2), np.maximum(between - at, 0.0).max(axis=2) + lacking", "sure.min(axis=2), lacking"),
        ("np.maximum(between - at, 0.0).max(axis=2) + lacking", "np.maximum(between - at, 0.0).max(axis=2)"),
        ("scale = np.minimum(1.0, ratio.min(axis=2))", "scale = np.minimum(1.0, ratio.max(axis=2))"),
        ("sure.min(axis=2)", "sure.mean(axis=2)"),
        ("take = np.all(moved >= 0.0, axis=2) &", "take ="),
        ("mass[-1] = float(left[-1] <= a <= right[-1])", "mass[-1] = 1.0"),
        ("mass = ((left <= a) & (a < right)).astype(float)", "mass = ((left <= a) & (a <= right)).astype(float)"),
        ("np.maximum(last - first, 0.0) / (b - a)", "np.maximum(last - first, 0.0) / (b - a) * (1.0 + 1e-6)"),
        ("middle = 0.5 * first + 0.5 * last", "middle = 1.0 * last"),
        ("off = 8.0 * U * (np.abs(middle) + np.abs(left)) / (right - left) + 4.0 * U", "off = 0.0 * middle"),
        ("if a == b:  # a point on", "if True:  # a point on"),
        ("min(t, len(self.policy) - 1)", "min(t + 1, len(self.policy) - 1)"),
    ),
    *_in(
        "tree",
        ("if np.any(overlap & ~np.eye(len(here), dtype=bool)) or done[q]:", "if done[q]:"),
        (
            "if np.any(overlap & ~np.eye(len(here), dtype=bool)) or done[q]:",
            "if np.any(overlap & ~np.eye(len(here), dtype=bool)):",
        ),
        ("overlap &= both[", "overlap |= both["),
        ("(-1 - entry == target or done[-1 - entry])", "(True or done[-1 - entry])"),
        ("if label >= 0 else set()", "if label > 0 else set()"),
        ("if label <= 0 else set()", "if label < 0 else set()"),
        ("if any(np.any(np.diff(key) < 0) for key in keys):", "if False:"),
        (
            "return [automaton.is_co_safe and accepts for accepts in automaton.accepting]",
            "return [accepts for accepts in automaton.accepting]",
        ),
        ("if np.any(guards.source[guard] != q):", "if False:"),
        ("if len(np.unique(vertices, axis=0)) != len(vertices):", "if False:"),
        ("if np.any(child >= counts[guards.target[guard]]):", "if False:"),
        (
            "if np.any(unions[:, :2] >= n) or np.any(kept >= n) or np.any(agent >= n_agents):",
            "if np.any(unions[:, :2] >= n) or np.any(kept >= n):",
        ),
        ("((rest != 0) & (np.abs(rest) - 1 == agent))", "False"),
        ("twice |= a == b or a in gone or b in gone", "twice |= a in gone or b in gone"),
        ("twice |= a == b or a in gone or b in gone", "twice |= a == b"),
        ("gone |= set() if remains else {b}", "gone |= {b}"),
        ("if twice or gone & set(kept.tolist()):", "if twice:"),
        ("twice = len(np.unique(kept)) != len(kept)", "twice = False"),
        ("first + second if agent == i else least", "first + second"),
        ("first + second if agent == i else least", "first + second if agent == i else first"),
        ("remaining = first if rest > 0 else second", "remaining = first"),
        (
            "np.maximum(remaining * share - least, 0.0) if abs(rest) - 1 == i else least",
            "remaining if abs(rest) - 1 == i else least",
        ),
        ("if abs(rest) - 1 == i else least", "if abs(rest) == i else least"),
        ("_unite(vertex, unions, i, KEPT if cells.kernel.inputs else 1.0)", "pass"),
        ("_unite(vertex, unions, i, KEPT if", "_unite(vertex, unions, i, 1.0 if"),
        ("float(np.prod(read, axis=0).sum())", "float(np.min(read, axis=0).sum())"),
        ('whole = id(kernel), b"".join(number), policy.tobytes()', 'whole = 0, b"".join(number), policy.tobytes()'),
        ('whole = id(kernel), b"".join(number), policy.tobytes()', 'whole = id(kernel), b"".join(number), b""'),
        ("distinct.max(axis=1, initial=0.0)", "distinct.min(axis=1, initial=1.0)"),
        ("vertex = cut * later.factors", "vertex = 1.0 * later.factors"),
        ("later.terms[target].T, strict=True)", "later.terms[0].T, strict=True)"),
        ("total * (1.0 - 4.0 * U * count)", "total * (1.0 + 4.0 * U * count)"),
        ("for t in range(team.horizon - 1, -1, -1):", "for t in range(team.horizon - 1, 0, -1):"),
    ),
    *_in(
        "cell_proofs",
        ("if problem.pairs:", "if False:"),
        ("if any(np.any(agent.shared_noise) for agent in problem.agents):", "if False:"),
        ("if any(agent.angles for agent in problem.agents):", "if False:"),
        ("check_guards(problem.automaton, proof.guards, [own.sets for own in proof.cells], known)", "pass"),
        ("check_guards(problem.automaton, start, [own.start_sets for own in proof.cells], known)", "pass"),
        (
            "if not np.array_equal(low, agent.state_box[0]) or not np.array_equal(high, agent.state_box[1]):",
            "if False:",
        ),
        ("if np.any(used.sum(axis=1) != 1) or np.any(used.sum(axis=0) > 1):", "if False:"),
        ("if agent.scale or any(envelope != STANDARD for envelope in agent.envelopes):", "if False:"),
        ("least[5:] = 1 - below[-1]", "least[5:] = -(2**31)"),
        ("least[5:] = 1 - below[-1]", "least[:] = 1 - below[-1]"),
        ("(rows < least) | (rows >= np.array(below))", "(rows < least)"),
        ("if np.any(table >= np.array(sets)):", "if False:"),
        ("if len(policy) not in (1, problem.horizon):", "if False:"),
        ("np.any(np.diff(axis) <= 0.0)", "False"),
        ("numbers = agent.noise.tobytes(), agent.input_box.tobytes(), self.policy.tobytes()", "numbers = ()"),
        ("rest = check_targets(agent, self.edges, self.inverse, aimed[:, 0], targets)", "pass"),
        ("np.abs(agent.noise).sum(axis=1)", "(agent.noise**2).sum(axis=1)"),
        ("float(np.nextafter(1.0 - value, 2.0))", "float(1.0 - value - 1e-9)"),
    ),
    *_in(
        "verdict",
        ("if not failure <= claimed:", "if failure > claimed + 1e-6:"),
        ("if not 0.0 <= claimed <= 1.0:", "if False:"),
        ("contents.everything_was_used()", "pass"),
        ("(wrong := wrong_automaton(problem.automaton, problem.formula))", '(wrong := "")'),
        ("if wrong := wrong_arithmetic():", 'if wrong := "":'),
    ),
    *_in(
        "rigorous",
        ("(one + 2.0**-53)[0] != 1.0 or", ""),
        ("if (np.array([2.0**-1022]) * 0.5)[0] != 2.0**-1023 or np.nextafter(0.0, 1.0) != 5e-324:", "if False:"),
        ("if any(abs(exact - Fraction(got)) > abs(exact - Fraction(neighbour)) for neighbour in near):", "if False:"),
        ("if not low * low <= Fraction(a) <= high * high:", "if False:"),
        ("> n * Fraction(U) * sum(map(abs, terms)):", "> 2**30 * n * Fraction(U) * sum(map(abs, terms)):"),
    ),
    *_in(
        "networks",
        ("parts, np.stack([-off, off]), here, self.seen)", "parts, np.zeros((2, len(off))), here, self.seen)"),
        ("own = add(np.sort(slope * self.own, axis=0), rest)", "own = rest"),
        ("off = 1.01 * (n + 2.0) * unit * (size @ self.size + np.abs(bias)) + 4.0", "off = 4.0"),
        ("ends = add(line, others)", "ends = line"),
        ("(slope[:, None] * g, q)", "(g, q)"),
        ("total = add(self.own, self.seen.forms(self.Q))", "total = self.own"),
        ("Q = Q + bend[:, None, None] * self.C", "Q = Q + 0.5 * bend[:, None, None] * self.C"),
        ("np.abs(bend) * more * (2.0 * far + more)", "0.0 * bend"),
        ("Q = np.tensordot(weight, self.Q, axes=1)", "Q = np.tensordot(np.abs(weight), self.Q, axes=1)"),
        ("np.abs(h) + reach + off, seen)", "np.abs(h), seen)"),
        ("np.arange(states) == max(q, 0), left", "np.arange(states) == max(q - 1, 0), left"),
        ("np.arange(states) == max(q, 0), left", "np.arange(states) == max(q, 0), 1.0"),
        ('"tanh": (tanh, 0.76981)', '"tanh": (tanh, 0.2)'),
        ('"sigmoid": (_logistic, 0.09623)', '"sigmoid": (_logistic, 0.02)'),
        ("interval(-np.ones_like(x[0])))), 1.0)", "interval(-np.ones_like(x[0])))), 0.2)"),
        ("mul(x, _logistic(x)), 0.50001)", "mul(x, _logistic(x)), 0.1)"),
        ("np.clip(low, first, last), np.clip(high, first, last), last", "z, z, last"),
        ("first, last = down(z + ends[0]), up(z + ends[1])", "first, last = down(z + 0.9 * ends[0]), up(z + ends[1])"),
        ("np.linspace(first, last, PIECES + 1)", "np.linspace(first, z, PIECES + 1)"),
        ("rest = there - (value + d * (slope + bend * d))", "rest = there - (value + d * (slope + 1.1 * bend * d))"),
        ("(most + 2.0 * np.abs(bend)) / 8.0 * (1.001 * wide / PIECES) ** 2", "0.0 * wide"),
        ("ACTIVATION_OFF * np.maximum(size, 1.0) if most else 0.0", "0.0"),
        ("states = {q for q in states if not automaton.accepting[q]}", "states = set(states)"),
        (" or count < len(agent.inputs):", ":"),
    ),
    *_in(
        "feedbacks",
        ("plain = plain.off_by(OFF * (1.0 + plain.size))", "plain = plain.off_by(0.0 * plain.size)"),
        ('1.0 if name == "+" else -1.0', "1.0"),
        ("self.layer(inner).times(-np.eye(1), none)", "self.layer(inner)"),
        (".off_by(up(a.size * up(high - low)))", ""),
        ("a, b = (b, a) if np.any(b.C) else (a, b)", "pass"),
        ('(none - np.inf, none + end) if name == "min"', '(none + end, none + np.inf) if name == "min"'),
        ("replace(own, Q=0.0 * own.Q).rest() for own", "np.zeros((2, 1)) for own"),
        ("np.clip((low, high), *ends[:, k]) if first == last else (first, last)", "(low, high)"),
    ),
    *_in(
        "fields",
        ("if unknown := [key for key in found if key not in (*keys, *optional)]:", "if False:"),
        ("if type(self.value) is not int or not least <= self.value < below:", "if not least <= self.value < below:"),
        (
            "if type(self.value) not in (int, float) or not abs(self.value) <= LARGEST:",
            "if not isinstance(self.value, int | float):",
        ),
        ("if np.any(ends[0] > ends[1]):", "if False:"),
        ("if len(set(names)) != len(names):", "if False:"),
        ("(count is not None and len(self.value) != count)", "False"),
        ("if array.size and not (least <= int(array.min()) and int(array.max()) < below):", "if False:"),
        ("if np.isnan(array).any() or (not infinite and", "if (not infinite and"),
        ("any(b is not None and a != b for a, b in zip(array.shape, shape))", "False"),
    ),
    *_in(
        "file",
        ("if zlib.crc32(data) != entry[5]:", "if False:"),
        ("if bytes(raw[at:]) != closing:", "if False:"),
        ("if len(found) != len(pairs):", "if False:"),
        ("if flags or method or extra or packed != size or name_length > 40:", "if False:"),
        ('raise Unreadable(f"the header holds {word}, which is no number")', "return float(word)"),
    ),
]

FIRST = {
    "rigorous": ("functions", "wrong"),
    "intervals": ("intervals",),
    "jets": ("jets", "runs"),
    "automaton": ("automata",),
    "formula": ("automata",),
    "letters": ("outputs", "automata", "files", "forged"),
    "angles": ("outputs",),
    "constraints": ("functions", "rows", "first_failures", "files", "runs"),
    "error_system": ("rows", "first_failures", "networks"),
    "trajectories": ("files", "runs", "forged"),
    "steps": ("files", "outputs", "networks", "runs", "forged"),
    "problem": ("files", "runs"),
    "distributions": ("distributions", "functions", "cells"),
    "motions": ("cells", "outputs"),
    "cells": ("cells",),
    "tree": ("the_tree",),
    "cell_proofs": ("files",),
    "verdict": ("files", "wrong", "forged"),
    "networks": ("networks",),
    "feedbacks": ("networks",),
    "fields": ("files", "forged"),
    "file": ("files", "forged"),
}
"""Words in the names of test files that are about a file of the checker."""

NOT_OF_A_COPY = ("stands_alone", "canonical_problems", "controllers")
"""Test files that read the folder of the checker itself, or what the package writes."""


def copy_with(mutant: Mutant, folder: Path) -> None:
    """Make a package in ``folder`` that is this one, but for one line of the checker."""
    package = folder / "certigym"
    package.mkdir()
    for path in PACKAGE.iterdir():
        if path.name not in ("synthesis", "__pycache__"):
            (package / path.name).symlink_to(path.resolve())
    (package / "synthesis").mkdir()
    for path in (PACKAGE / "synthesis").iterdir():
        if path.name not in ("checker", "__pycache__"):
            (package / "synthesis" / path.name).symlink_to(path.resolve())
    checker = package / "synthesis" / "checker"
    checker.mkdir()
    for path in (PACKAGE / "synthesis" / "checker").glob("*.py"):
        text = path.read_text(encoding="utf-8")
        (checker / path.name).write_text(
            text.replace(mutant.old, mutant.new, 1) if path.stem == mutant.file else text, encoding="utf-8"
        )


def stages(mutant: Mutant) -> Iterator[tuple[str, list[str]]]:
    """Marks and test files, in the order in which they are run: those that are about the sabotaged file first."""
    files = [p for p in sorted(TESTS.glob("test_*.py")) if not any(word in p.stem for word in NOT_OF_A_COPY)]
    about = [str(p) for p in files if p.stem.removeprefix("test_").startswith(FIRST[mutant.file])]
    others = [str(p) for p in files if str(p) not in about]
    yield "not thorough", about
    yield "thorough", about
    yield "not thorough", others
    yield "thorough", others


def noticed_by(mutant: Mutant, most: int) -> str:
    """The first test that fails in so many stages; an empty text if none does."""
    for stage, (marked, files) in enumerate(itertools.islice(stages(mutant), most)):
        if not files:
            continue
        with tempfile.TemporaryDirectory() as name:
            copy_with(mutant, Path(name))
            command = [
                sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "--noconftest", "-o",
                f"pythonpath={TESTS} {TESTS.parent}", "--tb=no", "-m", marked, *files,
            ]  # fmt: skip
            where = {**os.environ, "PYTHONPATH": name, "PYTHONDONTWRITEBYTECODE": "1", "OMP_NUM_THREADS": "1"}
            where["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
            try:  # tests about the file take seconds; all others, on a machine that others use too, many minutes
                limit = 300 if stage < 2 else 3600
                run = subprocess.run(command, cwd=ROOT, env=where, capture_output=True, text=True, timeout=limit)
            except subprocess.TimeoutExpired:
                return "(it does not end)"
        lines = [line for line in run.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
        if lines:
            test = lines[0].split(" - ")[0].split("tests/checker/")[-1]
            return test.removeprefix("test_").replace(".py::test_", ": ").replace(".py", "")
        if run.returncode not in (0, 5):
            raise RuntimeError(run.stdout[-2000:] + run.stderr[-2000:])
    return ""


def main() -> None:
    """Run all mutants, or some of them, and write what came out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="files of the checker whose name holds this word")
    parser.add_argument("--survivors", action="store_true", help="only those that nothing noticed the last time")
    parser.add_argument("--missing", action="store_true", help="only those that were not run")
    parser.add_argument(
        "--stages", type=int, default=4, help="1: tests about the file, 2: thorough ones, too, 3: all others, 4: all"
    )
    options = parser.parse_args()
    known = json.loads(RECORD.read_text(encoding="utf-8")) if RECORD.exists() else []
    record = {(row["file"], row["old"], row["new"]): row for row in known}
    for mutant in MUTANTS:
        text = (PACKAGE / "synthesis" / "checker" / f"{mutant.file}.py").read_text(encoding="utf-8")
        if mutant.old not in text:
            raise ValueError(f"{mutant.file}: {mutant.old!r} is not there: write the mutant anew")
        compile(text.replace(mutant.old, mutant.new, 1), mutant.file, "exec")
    # a run that is cut short has seen something of every file
    order = sorted(range(len(MUTANTS)), key=lambda n: (n % 5, n))
    for number in order:
        mutant = MUTANTS[number]
        row = record.get(tuple(mutant))
        if (
            options.only not in mutant.file
            or (options.survivors and (row is None or row["test"]))
            or (options.missing and row)
        ):
            continue
        start = time.perf_counter()
        test = noticed_by(mutant, options.stages)
        record[tuple(mutant)] = {**mutant._asdict(), "test": test, "seconds": round(time.perf_counter() - start, 1)}
        print(f"{number + 1}/{len(MUTANTS)} {mutant.file}: {mutant.new[:50]!r}: {test or 'NOT NOTICED'}", flush=True)
        rows = [record[tuple(own)] for own in MUTANTS if tuple(own) in record]
        RECORD.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    write_page([record[tuple(own)] for own in MUTANTS if tuple(own) in record])


MARK = "<!-- what came out -->"


def write_page(rows: list[dict[str, str]]) -> None:
    """Write the table below its mark in the page: how many mutants of each file are noticed, and by how many tests."""
    noticed = sum(bool(row["test"]) for row in rows)
    lines = [
        f"{len(rows)} mutants, of which tests notice {noticed}. Each line and the first test that fails:",
        "[checker_mutations.json](checker_mutations.json).",
        "",
        "| file | mutants | noticed | first tests |",
        "|---|---|---|---|",
    ]
    for file in dict.fromkeys(row["file"] for row in rows):
        own = [row for row in rows if row["file"] == file]
        tests = {row["test"].split("[")[0] for row in own if row["test"]}
        lines.append(f"| {file} | {len(own)} | {sum(bool(row['test']) for row in own)} | {len(tests)} |")
    head = PAGE.read_text(encoding="utf-8").split(MARK)[0]
    PAGE.write_text(f"{head}{MARK}\n\n" + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
