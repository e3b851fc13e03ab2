"""Run the commands with ``python -m jaxsr``."""

import sys

from jaxsr.cli import main

sys.exit(main())
