"""The paper's figures and tables, recomputed.

The paper's figures and tables, recomputed by the paper's own method, and benchmarks of others.
"""

from .judged_lines import RECORDED, lines_text, summary_text
from .lograsm import AIM, certified_networks, write_networks
from .lograsm import table as network_table
from .reproduction import Reproduction, computed
from .targets import TARGETS, lines_of, target_of
