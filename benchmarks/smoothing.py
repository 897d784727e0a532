"""Forms of the Gaussian box kernel, timed against the one in use: ``python benchmarks/smoothing.py [--json PATH]``.

Cells have width 1, means lie on their centres. Times are ratios to the banded table of `synthesis.models` in the same
run: below 1 a form is faster. `fft` and `low rank` have absolute errors: `over` is the largest excess over the exact
table that was observed on random values in [0, 1], and `charge` is what a proof would have to subtract from every
value.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable
from dataclasses import dataclass
from unittest import mock

import numpy as np
import scipy.fft
from numpy.typing import NDArray

import certigym as cg
from certigym.synthesis.models.abstraction import abstract
from certigym.synthesis.models.joint import join, start_of
from certigym.synthesis.readings.kernel import AxisTable, Kernel, gaussian_masses, gaussian_table
from certigym.synthesis.search.ascent import resting_policies, sweep
from certigym.synthesis.search.limits import Limits
from certigym.synthesis.values.devices import UNIT
from measuring import Row, Rows, cpu, options, save, show

Array = NDArray[np.float64]
Smooth = Callable[[Array], Array]
TAIL = 1e-12
"""Frobenius norm that the low-rank form leaves out."""


@dataclass(frozen=True, eq=False)
class Form:
    """A way to smooth (n, S) values, and the absolute error of a value in [0, 1] that a proof has to subtract."""

    smooth: Smooth
    charge: float


def axis_forms(cells: int, std: float) -> dict[str, Form]:
    """Return all forms of one axis."""
    means, edges = np.arange(cells) + 0.5, np.arange(cells + 1.0)
    dense, loss = gaussian_masses(means, edges, std)
    banded, banded_loss = gaussian_table(means, edges, std)
    small = np.where(dense < 1e-30, 0.0, dense).astype(np.float32)  # no denormal numbers
    return {
        "banded": Form(banded.smooth, banded_loss),
        "dense": Form(AxisTable.dense(dense).smooth, loss),
        "float32": Form(AxisTable.dense(small).smooth, (cells + 2) * 2.0**-24),
        "fft": _fft(cells, std),
        "low rank": _low_rank(dense),
    }


def _fft(cells: int, std: float) -> Form:
    """Return the convolution on a circle that is long enough not to wrap.

    Each of the three transforms errs by at most ``7 u log2 N`` of the 2-norm (Higham, Theorem 24.2, rounded up).
    """
    half = min(cells - 1, int(np.ceil(9.5 * std)))
    row, _ = gaussian_masses(np.array([half + 0.5]), np.arange(2.0 * half + 2), std)
    length = scipy.fft.next_fast_len(cells + half, real=True)
    circle = np.zeros(length)
    circle[: half + 1] = row[0, half:]
    if half:
        circle[-half:] = row[0, :half]
    spectrum = scipy.fft.rfft(circle)

    def smooth(values: Array) -> Array:
        moved = scipy.fft.rfft(values, length, axis=-1) * spectrum
        return np.asarray(scipy.fft.irfft(moved, length, axis=-1)[..., :cells])

    return Form(smooth, 22 * UNIT * np.log2(length) * np.sqrt(cells) * float(np.linalg.norm(circle)))


def _low_rank(dense: Array) -> Form:
    left, sizes, right = np.linalg.svd(dense)
    rest = np.sqrt(np.cumsum(sizes[::-1] ** 2)[::-1])
    rank = int((rest > TAIL).sum())
    first, second = np.ascontiguousarray(right[:rank].T), np.ascontiguousarray((left[:, :rank] * sizes[:rank]).T)
    dropped = float(rest[rank]) if rank < len(rest) else 0.0
    charge = np.sqrt(len(dense)) * (dropped + 2 * len(dense) * UNIT * sizes[0])
    return Form(lambda values: (values @ first) @ second, float(charge))


def one_axis() -> Rows:
    rows = []
    rng = np.random.default_rng(0)
    for cells in (100, 250, 500, 1000, 2000, 4000):
        for std in (1, 5, 20, 50):
            forms = axis_forms(cells, std)
            for factors in (1, 10, 100, 400):
                rows.append({"cells": cells, "std": std, "factors": factors} | _compared(forms, rng, (factors, cells)))
    return rows


def two_axes() -> Rows:
    rows = []
    rng = np.random.default_rng(0)
    for cells in (25, 50, 100, 200, 400):
        for std in (1, 5, 20):
            tables = gaussian_table(np.arange(cells) + 0.5, np.arange(cells + 1.0), std)[0]
            axis = axis_forms(cells, std)
            forms = {name: Form(_twice(own.smooth, cells), 2 * own.charge) for name, own in axis.items()}
            forms["banded"] = Form(Kernel((tables, tables)).smooth, axis["banded"].charge)
            for factors in (1, 10, 50):
                shape = (factors, cells * cells)
                rows.append({"cells": f"{cells}^2", "std": std, "factors": factors} | _compared(forms, rng, shape))
    return rows


def sweep_row(name: str, cells: int, **settings: int) -> Row:
    """Smooth the factors of a real improving sweep by each form; return the shares of the sweep's time."""
    problem = cg.make_problem(name, **settings)
    joint = join(problem, abstract(problem, cells, relation="exact"))
    start = start_of(problem, joint)
    policies = sweep(joint, resting_policies(joint), None, Limits(), improve=True).policies
    whole, _ = cpu(lambda: sweep(joint, policies, start, Limits(), improve=True), 2)
    met: list[Array] = []
    with mock.patch.object(AxisTable, "smooth", _recording(met)):
        sweep(joint, policies, start, Limits(), improve=True)
    model = joint.models[0]
    table, width = model.kernel.tables[0], float(np.diff(model.lattice[0]).mean())
    dense, per_cell = table.toarray(), round(float(np.diff(model.grid.edges[0]).mean()) / width)
    forms = {
        "banded": table.smooth,
        "dense": AxisTable.dense(dense).smooth,
        "low rank": _low_rank(dense).smooth,
        "fft": _on_finer_lattice(dense, per_cell),
    }
    shares = {key: cpu(lambda f=form: [f(v) for v in met], 2)[0] / whole for key, form in forms.items()}  # type: ignore[misc]
    return {"task": name, "cells": cells, "factors": sum(map(len, met)), "sweep ms": 1e3 * whole} | shares


def in_a_sweep() -> Rows:
    """Measure the paper's two examples at their sizes."""
    return [sweep_row("reach-avoid-v0", 1000, horizon=7), sweep_row("package-delivery-v0", 1200)]


def _recording(met: list[Array]) -> Callable[[AxisTable, Array], Array]:
    smooth = AxisTable.smooth

    def recorded(table: AxisTable, values: Array) -> Array:
        met.append(values)
        return smooth(table, values)

    return recorded


def _on_finer_lattice(table: Array, per_cell: int) -> Smooth:
    """Return the convolution for several lattice points per cell; only its time is used, not its values."""
    n_lattice, cells = table.shape
    length = scipy.fft.next_fast_len(per_cell * cells + n_lattice, real=True)
    spectrum = scipy.fft.rfft(np.resize(table[n_lattice // 2], length))

    def smooth(values: Array) -> Array:
        finer = np.zeros((len(values), length))
        finer[:, : per_cell * cells : per_cell] = values
        return np.asarray(scipy.fft.irfft(scipy.fft.rfft(finer) * spectrum, length)[:, :n_lattice])

    return smooth


def _twice(smooth: Smooth, cells: int) -> Smooth:
    """Smooth the last axis, then the one before it."""

    def both(values: Array) -> Array:
        square = smooth(values.reshape(-1, cells)).reshape(-1, cells, cells)
        turned = smooth(np.ascontiguousarray(square.transpose(0, 2, 1)).reshape(-1, cells)).reshape(-1, cells, cells)
        return turned.transpose(0, 2, 1).reshape(len(values), -1)

    return both


def _compared(forms: dict[str, Form], rng: np.random.Generator, shape: tuple[int, int]) -> dict[str, float]:
    """Return the time of each form as a ratio to the banded one, and the errors of forms that are not lower bounds."""
    values = rng.random(shape)
    seconds, reference = cpu(lambda: forms["banded"].smooth(values))
    row = {"banded us": 1e6 * seconds}
    for name, form in forms.items():
        if name != "banded":
            given = values.astype(np.float32) if name == "float32" else values
            own, smoothed = cpu(lambda form=form, given=given: form.smooth(given))  # type: ignore[misc]
            row[name] = own / seconds
            if name in ("fft", "low rank"):
                row[f"{name} over"] = float(np.max(smoothed - reference))
                row[f"{name} charge"] = form.charge
    return row


def main() -> None:
    chosen = options(__doc__)
    results = {}
    for title, work in {"shares of a sweep": in_a_sweep, "one axis": one_axis, "two axes": two_axes}.items():
        results[title] = work()
        show(title, results[title])
    save(results, chosen.json)


if __name__ == "__main__":
    main()
