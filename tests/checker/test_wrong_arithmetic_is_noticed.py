"""A machine that flushes small numbers to zero, or rounds in another way, is noticed before anything is proved."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from certificate_files import file_of, two_carts
from certigym.synthesis.checker import check_contents, parse_file, rigorous


class Machine(np.ndarray):
    """Arrays whose sums, products and quotients go through another rounding."""

    rounding: Callable[[Any, str], Any] = staticmethod(lambda exact, name: exact)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **rest: Any) -> Any:
        plain = [np.asarray(own) for own in inputs]
        result = getattr(ufunc, method)(*plain, **rest)
        if ufunc.__name__ in ("add", "multiply", "divide", "sqrt", "matmul"):
            wide = (
                getattr(ufunc, method)(*(own.astype(np.longdouble) for own in plain))
                if method == "__call__"
                else result
            )
            result = Machine.rounding(wide if ufunc.__name__ != "matmul" else result, ufunc.__name__)
        return np.asarray(result).view(Machine)


def nearest(exact: Any) -> Any:
    return np.asarray(exact).astype(np.float64)


def toward_zero(exact: Any, name: str) -> Any:
    rounded = nearest(exact)
    return np.where(np.abs(rounded.astype(np.longdouble)) > np.abs(exact), np.nextafter(rounded, 0.0), rounded)


def upward(exact: Any, name: str) -> Any:
    rounded = nearest(exact)
    return np.where(rounded.astype(np.longdouble) < exact, np.nextafter(rounded, np.inf), rounded)


def downward(exact: Any, name: str) -> Any:
    return -upward(-np.asarray(exact), name)


def flushed(exact: Any, name: str) -> Any:
    rounded = nearest(exact)
    return np.where(np.abs(rounded) < 2.0**-1022, 0.0, rounded)


def single(exact: Any, name: str) -> Any:
    return np.asarray(exact).astype(np.float32).astype(np.float64) if name == "matmul" else nearest(exact)


def off(of: str) -> Callable[[Any, str], Any]:
    return lambda exact, name: np.nextafter(nearest(exact), np.inf) if name == of else nearest(exact)


MACHINES: dict[str, Callable[[Any, str], Any]] = {
    "toward zero": toward_zero,
    "upward": upward,
    "downward": downward,
    "flush to zero": flushed,
    "sums": off("add"),
    "quotients": off("divide"),
    "roots": off("sqrt"),
    "matrices in single precision": single,
}


def on_machine(monkeypatch: pytest.MonkeyPatch, rounding: Callable[[Any, str], Any]) -> str:
    """The verdict of the self-test where arrays round in another way."""

    def array(values: Any, *rest: Any, **more: Any) -> Any:
        return np.array(values, *rest, **more).view(Machine)

    def arange(*rest: Any, **more: Any) -> Any:
        return np.arange(*rest, **more).view(Machine)

    own = {
        name: getattr(np, name) for name in ("nextafter", "spacing", "inf", "einsum", "sqrt", "sin", "cos", "matmul")
    }
    monkeypatch.setattr(Machine, "rounding", staticmethod(rounding))
    monkeypatch.setattr(rigorous, "np", SimpleNamespace(**{**own, "array": array, "arange": arange}))
    return rigorous.wrong_arithmetic()


def test_this_machine_computes_as_the_proofs_assume(monkeypatch: pytest.MonkeyPatch) -> None:
    assert rigorous.wrong_arithmetic() == ""
    assert on_machine(monkeypatch, lambda exact, name: nearest(exact)) == ""


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", MACHINES)
def test_another_arithmetic_is_noticed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert on_machine(monkeypatch, MACHINES[name])


def test_products_of_matrices_that_lose_a_term_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Products in single precision, in each of the three ways that the proofs use."""
    for name in ("matmul", "einsum"):
        real = getattr(np, name)

        def rough(*arrays: Any, real: Any = real) -> Any:
            return real(*arrays).astype(np.float32).astype(np.float64)

        with monkeypatch.context() as patch:
            patch.setattr(np, name, rough)
            assert "products" in rigorous.wrong_arithmetic()


def test_numbers_next_to_zero_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    real = np.nextafter
    monkeypatch.setattr(np, "nextafter", lambda a, b: real(a, b) if np.abs(real(a, b)).max() > 1e-300 else 2.0**-1022)
    assert "taken for 0" in rigorous.wrong_arithmetic()


def test_nothing_is_proved_on_such_a_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    contents = parse_file(file_of(*two_carts()))
    monkeypatch.setattr("certigym.synthesis.checker.verdict.wrong_arithmetic", lambda: "sums are wrong")
    with pytest.raises(ArithmeticError, match="sums are wrong"):
        check_contents(contents)
