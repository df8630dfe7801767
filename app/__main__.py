"""``python -m app`` is ``artiworld``."""

import sys

from app.cli import main

sys.exit(main())
