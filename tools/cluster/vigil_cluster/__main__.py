"""`vigil-cluster`: a campaign of `vigil` on a Ray cluster."""

import argparse
import shutil
import sys
from pathlib import Path

from vigil_cluster.driver import CampaignError, fly

EPILOG = """\
Examples:
  vigil-cluster evaluate --flights 500 --seed 1000000 -o runs/a.json           Ray in this process, all cores
  vigil-cluster evaluate --flights 100000 -o runs/big.json --address auto      the cluster that this machine belongs to
  vigil-cluster attack completion --flights 200 -o runs/completion.json        ray://HOST:10001 is an address, too

All other arguments are those of `vigil evaluate`, `vigil attack completion`, `search` or `defended`, `vigil detector
collect --set …`. The program and the files that the arguments name are sent along. The flights stay beside FILE in the folder
NAME.parts; after an interruption the same command goes on with them. The result is, byte for byte, what one machine
writes. docs/cluster.md explains it.

Exit code: 0 the whole was written, 1 error, 130 interrupted."""


def main(arguments=None) -> int:
    """Reads the arguments and flies; the exit code."""
    parser = argparse.ArgumentParser(
        prog="vigil-cluster",
        description="Fly a campaign of vigil on a Ray cluster.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("command", choices=["evaluate", "attack", "detector"], help="as in vigil; with what follows it")
    parser.add_argument("-o", "--output", "--json", type=Path, required=True, metavar="FILE", help="where the whole goes")
    parser.add_argument("--address", help="the Ray cluster; absent: Ray is started in this process")
    parser.add_argument("--at-a-time", type=int, default=20, metavar="N", help="seeds of a task [default: 20]")
    parser.add_argument("--retries", type=int, default=5, help="how often a lost part is flown again [default: 5]")
    parser.add_argument("--vigil", type=Path, metavar="FILE", help="the program [default: vigil in the PATH]")
    parser.add_argument("--installed", action="store_true", help="it is at the same place on every node: send nothing")
    own, rest = parser.parse_known_args(arguments)
    if own.at_a_time < 1:
        parser.error("--at-a-time is a number above 0")
    if any(word.split("=")[0] == "--shards" for word in rest):
        parser.error("--shards is of an earlier version: --at-a-time gives the seeds of a task")
    found = own.vigil or shutil.which("vigil")
    if found is None:
        parser.error("there is no program vigil in the PATH: name it with --vigil")
    try:
        words = [own.command, *rest]
        fly(words, own.output, found, own.address, own.at_a_time, own.retries, own.installed)
    except (CampaignError, ConnectionError, ValueError) as error:
        print(f"vigil-cluster: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("vigil-cluster: interrupted; the same command goes on with the flights that are there", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
