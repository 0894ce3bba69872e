"""`earshot doctor`: is everything here that a run needs, and if not, what to do."""

import argparse

from station.options import SubParsers, add_command

EXAMPLES = """examples:
  earshot doctor

exit codes: 0 all is well, 1 something is not"""


def add_parser(commands: SubParsers) -> None:
    parser = add_command(commands, "doctor", "check what a run needs of this machine", EXAMPLES)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    del args
    from station.doctor import examine

    ill = 0
    for finding in examine():
        ill += not finding.well
        mark = "ok  " if finding.well else "FAIL"
        advice = "" if finding.well else f": {finding.advice}"
        print(f"{mark} {finding.subject:24} {finding.detail}{advice}", flush=True)
    print("all is well" if not ill else f"{ill} of these need attention")
    return 1 if ill else 0
