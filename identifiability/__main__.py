"""Run the command line with ``python -m identifiability``."""

import sys

from identifiability.cli.main import main

sys.exit(main())
