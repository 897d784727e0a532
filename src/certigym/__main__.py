"""``python -m certigym`` is the command line ``certigym``."""

import sys

from .cli.main import main

sys.exit(main())
