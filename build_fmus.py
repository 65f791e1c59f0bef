"""Build the FMUs of this work tree: ``build_fmus.py [NAME | FILE.py[:CLASS] ...]``, the options are ``cosim build``'s.

``python build_fmus.py --references [NAME ...]`` makes again what FMUs carry beside their models: reference results,
validation picture and icon, in ``fmus/references``.
"""

import argparse
import sys
from pathlib import Path

from cosim.commands.build import build_all, build_arguments, build_loop, make_references
from cosim.commands.cli import exit_code
from cosim.export.workspace import Workspace

ROOT = Path(__file__).resolve().parent
WORKSPACE = Workspace(ROOT, ROOT / "build" / "cache")

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Build the FMUs of fmus/.", epilog="Example: build_fmus.py Trajectory")
    parser.add_argument("names", nargs="*", metavar="NAME", help="components or their files (default: all of fmus/)")
    parser.add_argument("--references", action="store_true", help="make fmus/references anew, build nothing")
    build_arguments(parser)
    options = parser.parse_args()
    if options.references:
        sys.exit(exit_code(lambda: make_references(WORKSPACE, WORKSPACE.select(options.names)) > 0))
    failed = exit_code(lambda: build_loop(options.platform, WORKSPACE.cache) or 0)
    sys.exit(failed or exit_code(lambda: build_all(options, WORKSPACE, ROOT / "build" / "fmus", split=True)))
