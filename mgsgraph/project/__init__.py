"""A kept project: a folder with an SQLite file, to which images are added as they come."""

from mgsgraph.project.project import Change as Change
from mgsgraph.project.project import Project as Project
from mgsgraph.project.project import SolutionRow as SolutionRow
from mgsgraph.project.project import open_project as open_project
from mgsgraph.project.store import ProjectStore as ProjectStore
