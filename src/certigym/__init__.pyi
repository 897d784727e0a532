"""What `certigym` offers; the names are loaded when they are first used (SPEC 1, `lazy_loader`)."""

__version__: str

from .envs.agents import Box as Box
from .envs.agents import LinearAgent as LinearAgent
from .envs.agents import Proposition as Proposition
from .envs.logic import Automaton as Automaton
from .envs.logic import FormulaError as FormulaError
from .envs.logic import automaton_from_hoa as automaton_from_hoa
from .envs.logic import automaton_from_transitions as automaton_from_transitions
from .envs.logic import translate as translate
from .envs.problem import Problem as Problem
from .envs.problem import Specification as Specification
from .envs.problem import load_problem as load_problem
from .envs.problem import split_axes as split_axes
from .envs.suite import aec_env as aec_env
from .envs.suite import central_env as central_env
from .envs.suite import make_problem as make_problem
from .envs.suite import parallel_env as parallel_env
from .envs.suite import problem_ids as problem_ids
from .envs.suite import vector_env as vector_env
from .synthesis.cells import Grid as Grid
from .synthesis.certificates import Certificate as Certificate
from .synthesis.certificates import ProductCertificate as ProductCertificate
from .synthesis.certificates import Synthesis as Synthesis
from .synthesis.certificates import load_certificate as load_certificate
from .synthesis.certificates import save_certificate as save_certificate
from .synthesis.certify import certify as certify
from .synthesis.certify import improve as improve
from .synthesis.checking import check as check
from .synthesis.controllers import AgentController as AgentController
from .synthesis.controllers import Controller as Controller
from .synthesis.controllers import InputTable as InputTable
from .synthesis.controllers import vectorized as vectorized
from .synthesis.horizons import synthesize_horizons as synthesize_horizons
from .synthesis.horizons import without_deadline as without_deadline
from .synthesis.models import abstract as abstract
from .synthesis.synthesize import synthesize as synthesize
from .validation.audits import AuditReport as AuditReport
from .validation.audits import audit as audit
from .validation.policies import Comparison as Comparison
from .validation.policies import IdleController as IdleController
from .validation.policies import RandomController as RandomController
from .validation.policies import Training as Training
from .validation.policies import as_controller as as_controller
from .validation.policies import compare as compare
from .validation.policies import load_actor as load_actor
from .validation.policies import train as train
from .validation.reports import gather_report as gather_report
from .validation.reports import write_report as write_report
from .validation.simulation import DaskExecutor as DaskExecutor
from .validation.simulation import Mismatch as Mismatch
from .validation.simulation import Rollouts as Rollouts
from .validation.simulation import rollout as rollout
from .validation.verdicts import FieldReport as FieldReport
from .validation.verdicts import StressReport as StressReport
from .validation.verdicts import ValidationReport as ValidationReport
from .validation.verdicts import find_weakest as find_weakest
from .validation.verdicts import stress as stress
from .validation.verdicts import sweep_horizons as sweep_horizons
from .validation.verdicts import synthesize_best as synthesize_best
from .validation.verdicts import validate as validate
from .validation.verdicts import validate_field as validate_field

__all__ = [
    "__version__",
    "AgentController",
    "AuditReport",
    "Automaton",
    "Box",
    "Certificate",
    "Comparison",
    "Controller",
    "DaskExecutor",
    "FieldReport",
    "FormulaError",
    "Grid",
    "IdleController",
    "InputTable",
    "LinearAgent",
    "Mismatch",
    "Problem",
    "ProductCertificate",
    "Proposition",
    "RandomController",
    "Rollouts",
    "Specification",
    "StressReport",
    "Synthesis",
    "Training",
    "ValidationReport",
    "abstract",
    "aec_env",
    "as_controller",
    "audit",
    "automaton_from_hoa",
    "automaton_from_transitions",
    "central_env",
    "certify",
    "check",
    "compare",
    "find_weakest",
    "gather_report",
    "improve",
    "load_actor",
    "load_certificate",
    "load_problem",
    "make_problem",
    "parallel_env",
    "problem_ids",
    "rollout",
    "save_certificate",
    "split_axes",
    "stress",
    "sweep_horizons",
    "synthesize",
    "synthesize_best",
    "synthesize_horizons",
    "train",
    "translate",
    "validate",
    "validate_field",
    "vector_env",
    "vectorized",
    "without_deadline",
    "write_report",
]
