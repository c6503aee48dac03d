"""`mgsgraph campaign`: many cases, each into a folder of its own."""

import threading
from pathlib import Path
from typing import TYPE_CHECKING

import click
from tqdm import tqdm

from mgsgraph.cli.overruling import overruling

if TYPE_CHECKING:
    from mgsgraph.campaign import CampaignEntry, Overrides

_PATIENCE = 20.0
"""s after which the silence is explained."""


@click.command(short_help="Adjust many cases.")
@click.argument("cases", type=click.Path(path_type=Path), nargs=-1, required=True, metavar="CASE|FOLDER...")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for all results and the record.")
@click.option("--cluster", metavar="PLACE", help="local, local:N (worker processes), tcp://host:port, tls://host:port.")
@click.option("--retry", is_flag=True, help="Do those again that have failed or not converged, though nothing changed.")
@overruling
@click.option("-v", "--verbose", is_flag=True, help="One line per case.")
@click.pass_context
def campaign(
    ctx: click.Context,
    cases: tuple[Path, ...],
    out: Path,
    cluster: str | None,
    retry: bool,
    overrides: "Overrides",
    verbose: bool,
) -> None:
    """Adjust each CASE (a TOML file; of a FOLDER, every *.toml at any depth) into a folder of its own in OUT.

    Options overrule all case files. OUT/campaign.jsonl records each case that is over. The same command again does
    what is new, what has changed and what was interrupted, and leaves the rest. Exit status: 0 all done, 1 some failed
    or did not converge, 2 bad input.
    """
    from mgsgraph.campaign import run_campaign
    from mgsgraph.campaign.run import summary

    bar = _CaseBar(verbose)
    try:
        done = run_campaign(cases, out, overrides, cluster, retry, bar)
    except KeyboardInterrupt:
        bar.close()
        click.echo(f"mgsgraph: interrupted; {bar.state()}; the same command goes on", err=True)
        ctx.exit(130)
    finally:
        bar.close()
    click.echo(summary(done))
    click.echo(f"Results are in {out}")
    ctx.exit(0 if done.well else 1)


class _CaseBar:
    """Progress over the cases that are due, on standard error where that is a terminal; a line each when verbose."""

    def __init__(self, verbose: bool) -> None:
        self._verbose, self._over, self._due, self._failed = verbose, 0, 0, 0
        self._bar: tqdm[None] | None = None
        self._timer = threading.Timer(_PATIENCE, self.explain)
        self._timer.daemon = True

    def __call__(self, over: int, due: int, entry: "CampaignEntry | None") -> None:
        """Show that a case is over."""
        from mgsgraph.campaign.run import line

        self._over, self._due = over, due
        if self._bar is None:
            self._bar = tqdm(total=due, desc="adjusting", unit="case", leave=False, disable=None)
            self._timer.start()
        if entry is None:
            return
        self._failed += entry.status == "failed"
        if self._verbose:
            tqdm.write(line(entry))
        if self._failed:
            self._bar.set_postfix_str(f"{self._failed} failed")
        self._bar.update()

    def state(self) -> str:
        """How far it is."""
        return f"{self._over} of {self._due} cases are over and recorded" if self._due else "nothing was begun"

    def explain(self) -> None:
        """Say why nothing has moved yet."""
        if self._over == 0 and self._due:
            click.echo("no case is over yet; the kernel may have to be compiled first: about a minute, once", err=True)

    def close(self) -> None:
        """Take the bar away."""
        self._timer.cancel()
        if self._bar is not None:
            self._bar.close()
