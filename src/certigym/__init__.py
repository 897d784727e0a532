"""Multi-agent environments with temporal-logic tasks, controllers with certified bounds, and their validation.

The names below are loaded when they are first used, so importing the package stays cheap.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HERE = Path(__file__).parent
if not (_HERE / "envs" / "__init__.py").is_file() and (_HERE.parents[1] / "pyproject.toml").is_file():
    __path__.append(str(_HERE.parents[1]))  # a checkout without its symbolic links (zip archive, Windows)

from .envs.registration import register_suite as _register_suite  # noqa: E402  (after the search path is set)

_register_suite()

if TYPE_CHECKING:
    from .envs.agent import LinearAgent as LinearAgent
    from .envs.automaton import Automaton as Automaton
    from .envs.box import Box as Box
    from .envs.central_env import central_env as central_env
    from .envs.formula import FormulaError as FormulaError
    from .envs.hoa import automaton_from_hoa as automaton_from_hoa
    from .envs.labeling import Proposition as Proposition
    from .envs.parallel_env import aec_env as aec_env
    from .envs.parallel_env import parallel_env as parallel_env
    from .envs.problem import Problem as Problem
    from .envs.problem_file import load_problem as load_problem
    from .envs.specification import Specification as Specification
    from .envs.split import split_axes as split_axes
    from .envs.suite import make_problem as make_problem
    from .envs.suite import problem_ids as problem_ids
    from .envs.translate import translate as translate
    from .envs.vector_env import vector_env as vector_env
    from .synthesis.abstraction import abstract as abstract
    from .synthesis.agent_controller import AgentController as AgentController
    from .synthesis.certificate import Certificate as Certificate
    from .synthesis.certificate_file import load_certificate as load_certificate
    from .synthesis.certificate_file import save_certificate as save_certificate
    from .synthesis.certify import certify as certify
    from .synthesis.certify import improve as improve
    from .synthesis.check import check as check
    from .synthesis.controller import Controller as Controller
    from .synthesis.decentralised import InputTable as InputTable
    from .synthesis.decentralised import vectorized as vectorized
    from .synthesis.grid import Grid as Grid
    from .synthesis.horizons import synthesize_horizons as synthesize_horizons
    from .synthesis.horizons import without_deadline as without_deadline
    from .synthesis.product import ProductCertificate as ProductCertificate
    from .synthesis.result import Synthesis as Synthesis
    from .synthesis.synthesize import synthesize as synthesize
    from .validation.actors import load_actor as load_actor
    from .validation.audit import audit as audit
    from .validation.audit_report import AuditReport as AuditReport
    from .validation.cluster import DaskExecutor as DaskExecutor
    from .validation.compare import Comparison as Comparison
    from .validation.compare import compare as compare
    from .validation.fields import FieldReport as FieldReport
    from .validation.fields import find_weakest as find_weakest
    from .validation.fields import validate_field as validate_field
    from .validation.mismatch import Mismatch as Mismatch
    from .validation.policies import IdleController as IdleController
    from .validation.policies import RandomController as RandomController
    from .validation.policies import as_controller as as_controller
    from .validation.report import gather_report as gather_report
    from .validation.report import write_report as write_report
    from .validation.rollout import Rollouts as Rollouts
    from .validation.rollout import rollout as rollout
    from .validation.stress import StressReport as StressReport
    from .validation.stress import stress as stress
    from .validation.sweeps import sweep_horizons as sweep_horizons
    from .validation.sweeps import synthesize_best as synthesize_best
    from .validation.train import Training as Training
    from .validation.train import train as train
    from .validation.validate import ValidationReport as ValidationReport
    from .validation.validate import validate as validate

_EXPORTS = {
    "AgentController": "synthesis.agent_controller",
    "AuditReport": "validation.audit_report",
    "Automaton": "envs.automaton",
    "Box": "envs.box",
    "Certificate": "synthesis.certificate",
    "Comparison": "validation.compare",
    "Controller": "synthesis.controller",
    "DaskExecutor": "validation.cluster",
    "FieldReport": "validation.fields",
    "FormulaError": "envs.formula",
    "Grid": "synthesis.grid",
    "IdleController": "validation.policies",
    "InputTable": "synthesis.decentralised",
    "LinearAgent": "envs.agent",
    "Mismatch": "validation.mismatch",
    "Problem": "envs.problem",
    "ProductCertificate": "synthesis.product",
    "Proposition": "envs.labeling",
    "RandomController": "validation.policies",
    "Rollouts": "validation.rollout",
    "Specification": "envs.specification",
    "StressReport": "validation.stress",
    "Synthesis": "synthesis.result",
    "Training": "validation.train",
    "ValidationReport": "validation.validate",
    "abstract": "synthesis.abstraction",
    "aec_env": "envs.parallel_env",
    "as_controller": "validation.policies",
    "audit": "validation.audit",
    "automaton_from_hoa": "envs.hoa",
    "central_env": "envs.central_env",
    "certify": "synthesis.certify",
    "check": "synthesis.check",
    "compare": "validation.compare",
    "find_weakest": "validation.fields",
    "gather_report": "validation.report",
    "improve": "synthesis.certify",
    "load_actor": "validation.actors",
    "load_certificate": "synthesis.certificate_file",
    "load_problem": "envs.problem_file",
    "make_problem": "envs.suite",
    "parallel_env": "envs.parallel_env",
    "problem_ids": "envs.suite",
    "rollout": "validation.rollout",
    "save_certificate": "synthesis.certificate_file",
    "split_axes": "envs.split",
    "stress": "validation.stress",
    "sweep_horizons": "validation.sweeps",
    "synthesize": "synthesis.synthesize",
    "synthesize_best": "validation.sweeps",
    "synthesize_horizons": "synthesis.horizons",
    "train": "validation.train",
    "translate": "envs.translate",
    "validate": "validation.validate",
    "validate_field": "validation.fields",
    "vector_env": "envs.vector_env",
    "vectorized": "synthesis.decentralised",
    "without_deadline": "synthesis.horizons",
    "write_report": "validation.report",
}

__all__ = ["__version__", *sorted(_EXPORTS)]


def __getattr__(name: str) -> Any:
    if name in _EXPORTS:
        value = getattr(import_module(f".{_EXPORTS[name]}", __name__), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
