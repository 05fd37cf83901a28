"""``python -m iher_robot`` is the command ``iher-robot``."""

from __future__ import annotations

import sys

from iher_robot.cli.app import main

if __name__ == "__main__":
    sys.exit(main())
