"""Kill learners at random moments, and check what each kill leaves against the host's tick log.

python -m tests.faults --kills 100 --seed 0 --out bench/results/faults.json
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import time
from datetime import datetime
from pathlib import Path

import typer

from iher_robot.storage.provenance import collect_provenance
from tests.faults.campaign import Campaign, deal
from tests.faults.moments import Kind
from tests.faults.small_disk import enter_namespace, why_no_disk
from tests.faults.violation import Violation


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=[kind.name for kind in Kind], action="append")
    parser.add_argument("--budget-minutes", type=float, default=0.2, help="of each run")
    parser.add_argument("--folder", type=Path, help="kept; by default one that is removed")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp(prefix="iher-faults-"))
    folder.mkdir(parents=True, exist_ok=True)
    if why_no_disk(folder):
        enter_namespace([sys.executable, "-m", "tests.faults", *sys.argv[1:]])
    kinds = deal(options.kills, options.seed)
    if options.only:
        kinds = [Kind[options.only[i % len(options.only)]] for i in range(options.kills)]
    command = ["python", "-m", "tests.faults", *sys.argv[1:]]
    provenance = collect_provenance(command, options.seed, datetime.now().astimezone())
    begun = time.monotonic()
    campaign = Campaign(folder, kinds, options.seed, options.budget_minutes, typer.echo)
    try:
        found = campaign.run()
    except Violation as violation:
        notes = "\n".join(getattr(violation, "__notes__", ()))
        typer.echo(f"VIOLATION: {violation}\n{notes}\nseed {options.seed}, everything: {folder}")
        sys.exit(1)
    minutes = (time.monotonic() - begun) / 60.0
    measured = {
        "kills": dict(found.kills),
        "kills in all": found.kills.total(),
        "not run": found.not_run,
        "in the middle of": dict(found.left),
        "runs finished": found.runs,
        "ticks with a command in force": found.true_ticks,
        "of these in flight at a kill, in no episode": found.in_flight,
        "worst over-count of a ledger, ticks": max((over for _, over in found.overcounts)),
        "kills and over-count of each run": found.overcounts,
        "budget minutes of a run": options.budget_minutes,
        "wall minutes": round(minutes, 1),
    }
    typer.echo(json.dumps(measured, indent=2))
    if options.out is not None:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(json.dumps(provenance | measured, indent=2) + "\n")
    if options.folder is None:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
