"""`python -m pa10cal` is the command line `pa10cal`."""

from __future__ import annotations

import sys

from pa10cal.commands.command_line import main

if __name__ == "__main__":
    sys.exit(main())
