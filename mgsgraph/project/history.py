"""`undo` and `redo` of all changes of a project, as deep as its history.

Each change keeps the content that it replaced (`former`). `undo` restores that content and adjusts; the change stays in
the history, but stands no longer, and its decisions about points (`decisions`) neither. Undo and redo are changes of
the history themselves. Solutions are no changes of content.
"""

from pathlib import Path

from mgsgraph.errors import InputError, errors_from
from mgsgraph.project.changes import Changed, apply_content, record_change
from mgsgraph.project.former import Former, former_content, former_network, read_former
from mgsgraph.project.project import Change, Project

_LISTED = 9
"""Changes that a message lists."""


def undo(project: Project, number: int | None = None, why: str = "") -> Changed:
    """Take back the last change that stands, or a change of a point by its number.

    Raises
    ------
    InputError
        Where there is none, or later changes touch the same points.
    """
    where, stands = str(project.folder), project.standing_changes()
    if number is None and not stands:
        raise InputError(where, "no change to undo", "a change after init (solutions are no changes)")
    change = project.change(stands[-1] if number is None else number)
    if change is None or change.number not in stands:
        found = f"change {number} is undone" if change and not change.stands else f"no change {number} to undo"
        known = ", ".join(map(str, stands[-_LISTED:])) or "there is none"
        raise InputError(where, found, f"a change that stands ({known})")
    former = read_former(project, change.number)
    later = stands[stands.index(change.number) + 1 :]
    if later and former.definitions is not None:
        found = f"change {change.number} ({change.verb} {change.what}) has later ones, from {later[0]} on"
        raise InputError(where, found, "the last change, or that of a point", "undo those first")
    touched = set(former.touched)
    for other in later:
        again = [name for name in read_former(project, other).touched if name in touched]
        if again:
            found = f"change {other} has changed point {again[0]} since"
            raise InputError(where, found, "the last change of its points", f"undo change {other} first")
    return _restored(project, "undo", change, former, why)


def redo(project: Project, why: str = "") -> Changed:
    """Carry out again the last change that was undone; `undo` takes it back again.

    Raises
    ------
    InputError
        Where there is none, or a new change came after it.
    """
    number = project.last_undo()
    last = None if number is None else project.change(number)
    change = None if last is None or last.undoes is None else project.change(last.undoes)
    if number is None or change is None:
        raise InputError(str(project.folder), "no change to redo", "an undo that no new change follows")
    return _restored(project, "redo", change, read_former(project, number), why)


def _restored(project: Project, verb: str, change: Change, former: Former, why: str) -> Changed:
    """Let former content replace the present one, and a change stand or not."""
    store, brought = project.store, [image.known for image in former.removed]
    whole = former.definitions is not None
    names = [known.image.name for known in brought]
    replaced = former_content(project, former.touched, names, former.absent, whole)
    network = former_network(store, former.points, brought)
    definitions = store.definitions() if former.definitions is None else former.definitions
    with errors_from(str(project.folder)):
        impact = apply_content(project, verb, former.touched, network, brought, former.absent, definitions)
    for image in former.removed:
        if image.picture:
            project.take_picture(image.known.image.name, Path(image.picture))
    if whole:
        project.restore_facts(former.facts)
    project.mark(change.number, verb == "redo")
    what = f"change {change.number} ({change.verb} {change.what})"
    recorded = record_change(project, verb, what, {}, impact, why, replaced, change.number)
    point = str(change.summary.get("point", ""))
    return Changed(verb, point, f"{verb.capitalize()} of {what}.", impact, recorded)
