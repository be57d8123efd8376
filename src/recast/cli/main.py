"""Entry point of the `recast` command."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated

import tyro

from recast.cli.actor import Actor
from recast.cli.bench import Bench
from recast.cli.demo import Demo
from recast.cli.doctor import Doctor
from recast.cli.eval import Eval
from recast.cli.log import Log
from recast.cli.planner import Planner
from recast.cli.recar import Recar
from recast.cli.report import Report
from recast.cli.run import Run
from recast.cli.scenario import Scenario
from recast.cli.scene import Scene
from recast.cli.trellis import Trellis
from recast.errors import InputError

Command = (
    Annotated[Demo, tyro.conf.subcommand("demo")]
    | Annotated[Log, tyro.conf.subcommand("log")]
    | Annotated[Scene, tyro.conf.subcommand("scene")]
    | Annotated[Actor, tyro.conf.subcommand("actor")]
    | Annotated[Recar, tyro.conf.subcommand("recar")]
    | Annotated[Eval, tyro.conf.subcommand("eval")]
    | Annotated[Bench, tyro.conf.subcommand("bench")]
    | Annotated[Trellis, tyro.conf.subcommand("trellis")]
    | Annotated[Planner, tyro.conf.subcommand("planner")]
    | Annotated[Scenario, tyro.conf.subcommand("scenario")]
    | Annotated[Run, tyro.conf.subcommand("run")]
    | Annotated[Report, tyro.conf.subcommand("report")]
    | Annotated[Doctor, tyro.conf.subcommand("doctor")]
)


def main(args: Sequence[str] | None = None) -> int:
    """Run one command; bad input ends in one line on stderr and exit code 2."""
    command = tyro.cli(
        Command,
        prog="recast",
        description="Closed-loop driving simulation from recorded logs.",
        config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes),
        args=args,
    )
    try:
        command()
    except InputError as error:
        print(f"recast: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("recast: interrupted; the same command resumes", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
