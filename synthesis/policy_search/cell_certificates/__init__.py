"""From policies on cells to certificates.

From policies on cells to certificates: bounds collected, and what the check says of them.
"""

from .agreement import along_path, judged
from .certification import certificate_of
from .on_cells import Plan, compared, continued, plain, searched
from .textbook_feedback import rollouts_of, textbook_runs, with_textbook_feedback
