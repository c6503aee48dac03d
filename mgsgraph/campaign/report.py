"""A campaign in words: how many cases ended how, and what is to be looked at."""

import textwrap
from collections import Counter

from mgsgraph.campaign.entry import Entry
from mgsgraph.campaign.run import Campaign

_WIDTH = 110
"""columns of the table."""
_NAME = 32
"""columns of a case's name at most."""


def summary(campaign: Campaign) -> str:
    """Counts, and a table of the cases that failed or did not converge; several lines."""
    total, kept = len(campaign.entries), len(campaign.kept)
    counts = ", ".join(
        f"{number} {status}" for status in ("done", "not converged", "failed") if (number := campaign.count(status))
    )
    earlier = f" ({kept} of them earlier, and nothing has changed since)" if kept else ""
    lines = [f"{total} case{'' if total == 1 else 's'}: {counts}{earlier}", *_other_versions(campaign)]
    troubled = [entry for entry in campaign.entries if entry.status != "done"]
    if troubled:
        width = min(max(len(entry.folder) for entry in troubled), _NAME)
        lines += ["", f"{'Case':<{width}}  {'state':<13}  why"]
        for entry in troubled:
            lines += _row(entry, width)
    return "\n".join(lines)


def line(entry: Entry) -> str:
    """One case that is over, in one line."""
    if entry.status == "failed":
        return f"{entry.folder}: failed after {entry.seconds:.1f} s: {entry.message}"
    sigma0 = "not defined" if entry.sigma0 is None else f"{entry.sigma0:.4g}"
    return f"{entry.folder}: {entry.status}, {entry.iterations} iterations, sigma0 {sigma0}, {entry.seconds:.1f} s"


def _row(entry: Entry, width: int) -> list[str]:
    name = entry.folder if len(entry.folder) <= width else f"{entry.folder[: width - 3]}..."
    head = f"{name:<{width}}  {entry.status:<13}  "
    return textwrap.wrap(entry.message, _WIDTH, initial_indent=head, subsequent_indent=" " * len(head))


def _other_versions(campaign: Campaign) -> list[str]:
    """A line where results that were left are another version's."""
    kept = Counter(entry.version for entry in campaign.entries if entry.case in campaign.kept)
    now = {entry.version for entry in campaign.entries if entry.case not in campaign.kept}
    others = [f"{number} by mgsgraph {version}" for version, number in sorted(kept.items()) if version not in now]
    return [f"Of the earlier ones, {', '.join(others)}."] if now and others else []
