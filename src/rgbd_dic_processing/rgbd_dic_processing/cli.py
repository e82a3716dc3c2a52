"""rgbd-dic: the one command-line tool. Each sub-command is a module of `commands`."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Sequence

from rgbd_dic_acquisition.errors import RgbdDicError

from .commands import (
    annotate,
    calibrate,
    check,
    find_panel,
    import_,
    info,
    plane,
    process,
    regions,
    report,
    simulate,
    up,
    validate,
)

EXIT_CODES = (
    "exit codes: 0 done; 1 it failed, the message says why and what to do; 2 the command line is wrong; "
    "3 it ran, but not one frame was valid; 130 interrupted"
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `rgbd-dic` with these arguments (default: the process's own); returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="rgbd-dic",
        description="Measure how far a crack opens from a moving RGB-D camera.",
        epilog=EXIT_CODES,
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for module in (
        up,
        check,
        process,
        regions,
        simulate,
        import_,
        calibrate,
        find_panel,
        plane,
        report,
        annotate,
        info,
        validate,
    ):
        module.add_parser(commands)
    options = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ended like Ctrl-C: nodes are stopped, results kept
    try:
        return options.run(options)
    except RgbdDicError as error:
        print(f"rgbd-dic {options.command}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"rgbd-dic {options.command}: interrupted", file=sys.stderr)
        return 130
