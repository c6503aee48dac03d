"""The pages keep their word: every block in README and docs runs or is checked, every link leads somewhere.

No block is left out: one in a language, or a page, that nothing here knows, fails.
"""

import ast
import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import textwrap
import tomllib
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import click
import msgspec
import pytest
from commands import call, refusal

import mgsgraph
from mgsgraph.cli import group
from mgsgraph.simulation import PairSettings, simulate_pair, write_pair

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = [*ROOT.glob("*.md"), *sorted(DOCS.rglob("*.md"))]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]


class Block(NamedTuple):
    """A fenced block."""

    page: str
    line: int
    language: str
    text: str

    @property
    def where(self) -> str:
        return f"{self.page}:{self.line}"


def blocks_of(path: Path) -> Iterator[Block]:
    text = path.read_text(encoding="utf-8")
    for found in re.finditer(r"^( *)(`{3,}|~{3,})([^\n]*)\n(.*?)^\1\2 *$", text, re.DOTALL | re.MULTILINE):
        line = text[: found.start()].count("\n") + 1
        yield Block(path.relative_to(ROOT).as_posix(), line, found[3].strip(), found[4])


BLOCKS = [block for path in PAGES for block in blocks_of(path)]


def in_language(*languages: str) -> list[Any]:
    return [pytest.param(block, id=block.where) for block in BLOCKS if block.language in languages]


# --- words


def test_no_phrase_of_the_private_dialect() -> None:
    """None of phrases.txt in pages, sources and what they print; line breaks and marks of comments count as blanks."""
    lines = (ROOT / "tests" / "phrases.txt").read_text(encoding="utf-8").splitlines()
    phrases = re.compile("|".join(line for line in lines if not line.startswith("#")), re.IGNORECASE)
    kinds = {".md", ".py", ".toml", ".html", ".js", ".rst"}
    paths = [path for folder in ("docs", "mgsgraph", "factors") for path in (ROOT / folder).rglob("*.*")]
    for path in [ROOT / "README.md", *(path for path in paths if path.suffix in kinds)]:
        found = phrases.search(re.sub(r"\s+(#+\s+)?", " ", path.read_text(encoding="utf-8")))
        assert found is None, f"{path}: {found}"


# --- pages


def test_pages_are_few_and_each_stands_in_the_index() -> None:
    """At most 45, each in one of the five kinds (a table of docs/index.md and a toctree)."""
    pages, index = sorted(path.stem for path in DOCS.rglob("*.md")), (DOCS / "index.md").read_text(encoding="utf-8")
    assert len(pages) <= 45
    kinds = re.findall(r"^## (Tutorials|How-to guides|Reference|Explanation|Evidence)$", index, re.MULTILINE)
    assert len(kinds) == 5
    listed = re.findall(r"^\| \[[\w ]+\]\((\w+)\.md\) \|", index, re.MULTILINE)
    assert sorted([*listed, "index"]) == pages
    trees = re.findall(r"```\{toctree\}\n(?::[^\n]*\n)+\n(.*?)```", index, re.DOTALL)
    assert [line.split("<")[-1].rstrip(">") for line in "".join(trees).split("\n") if line] == listed


@pytest.mark.parametrize("path", sorted(DOCS.rglob("*.md")), ids=lambda path: path.stem)
def test_no_page_is_longer_than_five_screens(path: Path) -> None:
    """200 lines of 110 characters, of text and of what is printed; tables and made parts are generated, or scroll."""
    text = re.sub(r"<!-- made: .*?<!-- end -->", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    lines = [line for line in text.splitlines() if line and not line.startswith("|")]
    assert path.stem in GENERATED or sum(max(1.0, len(line) / 110) for line in lines) <= 200


GENERATED = {"api", "case_file", "commands", "files", "input_keys", "glossary"}
"""Reference: looked up by headings, not read."""


# --- which block is whose


CHECKED = {"sh", "sh setup", "toml", "python", "text", "bibtex", "output", "none"}
"""Languages of blocks that a test below takes; directives ({...}) are the build's; output, none: what is printed."""
RUN = ("docs/api.md", "docs/cookbook.md")
"""Pages whose Python runs in `test_examples`, and is compared with what it prints."""


def test_no_block_is_left_out() -> None:
    left = [block.where for block in BLOCKS if block.language not in CHECKED and not block.language.startswith("{")]
    assert not left
    assert not [block.where for block in BLOCKS if block.language == "python" and block.page not in {*PYTHON, *RUN}]
    for path in PAGES:  # blocks by indentation are for formulas and what is printed
        outside = re.sub(r"^( *)```.*?^\1``` *$", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
        code = r"^ {4,}(mgsgraph |pip |python3? |import |format = |\[+\w+\]+ *$)"
        assert not re.search(code, outside, re.MULTILINE), path
    fences = sum(len(re.findall(r"^ *(?:```|~~~)", path.read_text(encoding="utf-8"), re.MULTILINE)) for path in PAGES)
    assert fences == 2 * len(BLOCKS)  # none that the pattern above does not see


# --- Python


def nothing(folder: Path) -> dict[str, object]:
    return {}


def a_case(folder: Path) -> dict[str, object]:
    write_pair(simulate_pair(PairSettings(ties=20, shots=8), seed=1), folder).rename(folder / "CASE.toml")
    return {}


def adjusted(folder: Path) -> dict[str, object]:
    a_case(folder)
    assert not call("adjust", folder / "CASE.toml", "--out", folder / "RESULT", "--no-figures")
    return {}


def a_demo(folder: Path) -> dict[str, object]:
    """The folder that README's first command makes, of the small pair."""
    assert not call("demo", "pair", "--out", folder / "mgsgraph-demo", "--no-figures")
    return {}


def a_network(folder: Path) -> dict[str, object]:
    a_case(folder)
    case = mgsgraph.read_case(folder / "CASE.toml")
    return {"network": case.network, "settings": case.settings}


def pixels(folder: Path) -> dict[str, object]:
    import matched

    matched.write(folder).rename(folder / "CASE.toml")
    return {}


def a_result(folder: Path) -> dict[str, object]:
    import matched

    from mgsgraph.files.networks.pvl import write_pvl_network
    from mgsgraph.files.networks.tie_points import control_network

    pixels(folder)
    write_pvl_network(control_network(matched.matches().ties, "mgsgraph", "MARS", "pair"), folder / "network.pvl")
    assert not call("adjust", folder / "CASE.toml", "--out", folder / "RESULT", "--no-figures")
    return {}


PYTHON: dict[str, tuple[Callable[[Path], dict[str, object]], str]] = {
    "README.md": (a_demo, "Solution("),
    "docs/analysis.md": (nothing, "PoseEstimate("),
    "docs/cluster.md": (a_network, ""),
    "docs/dem.md": (a_result, "Dem("),
    "docs/exchange.md": (nothing, "PointId of 1 point (they are counted anew)"),
    "docs/export.md": (adjusted, "Dimensions:"),
    "docs/gtsam.md": (a_case, "posterior sigmas from the minimum"),
    "docs/matching.md": (nothing, "19"),
    "docs/files.md": (adjusted, "SIM/A"),
    "docs/passes.md": (nothing, "1999-09-10T13:08:40: 4 nodes"),
    "docs/projects.md": (nothing, "Check against batch"),
    "docs/terrain.md": (nothing, "with terrain: mean sigmas"),
}
"""What a page's blocks, run one after the other, find in the folder and among their names, and a part of what they
print."""


LONG = ("docs/dem.md", "docs/matching.md", "docs/cluster.md")


@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=pytest.mark.slow if page in LONG else ()) for page in PYTHON]
)
def test_python_blocks_run(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given, said = PYTHON[page]
    blocks = [block for block in BLOCKS if block.page == page and block.language == "python"]
    assert blocks
    names = given(tmp_path)
    monkeypatch.chdir(tmp_path)
    for block in blocks:
        exec(compile(block.text, block.where, "exec"), names)  # our own page
    assert said in capsys.readouterr().out


# --- shell


FIRST = {"sh setup", "python"}


@pytest.mark.usefixtures("light_figures", "shared_data")
def test_the_commands_of_the_readme_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As they stand, after a demo of the small pair."""
    monkeypatch.chdir(tmp_path)
    a_demo(tmp_path)
    (tmp_path / "scripts").symlink_to(ROOT / "scripts")
    for block in BLOCKS:
        if (block.page, block.language) == ("README.md", "sh"):
            for words, _ in commands_in(block):
                assert not call(*words[1:]), words


@pytest.mark.slow
def test_the_first_command_of_the_readme_and_the_python_after_it(tmp_path: Path) -> None:
    """In a clone, by README's own installation."""
    subprocess.run(["git", "clone", "--quiet", ROOT, tmp_path / "clone"], check=True)
    install, _, *python = [one.text for one in BLOCKS if one.page == "README.md" and one.language in FIRST]
    outside = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    for words in (["sh", "-euc", install], [".venv/bin/python", "-P", "-c", "".join(python)]):
        subprocess.run(words, cwd=tmp_path / "clone", env=outside, check=True, timeout=1800)


def commands_in(block: Block) -> list[tuple[list[str], str]]:
    """Words and comment of each command; `A && B` are two."""
    found = []
    for line in block.text.replace("\\\n", " ").splitlines():
        words, comment = shlex.split(line, comments=True), line.partition(" #")[2]
        while "&&" in words:
            found.append((words[: words.index("&&")], ""))
            words = words[words.index("&&") + 1 :]
        if words:
            found.append((words, comment))
    return found


@pytest.mark.parametrize("block", in_language("sh", "sh setup"))
def test_shell_lines_are_commands_that_there_are(block: Block) -> None:
    for words, comment in commands_in(block):
        while re.fullmatch(r"[A-Z_]+=\S*", words[0]):
            words = words[1:]
        program = words[0].removeprefix(".venv/bin/")
        assert program in PROGRAMS, f"{block.where}: {program}"
        PROGRAMS[program](words[1:], comment)


TABLES = {"docs/passes.md"}
"""Pages that show it in tables of another page."""


WITH_COMMANDS = {block.page for block in BLOCKS if block.language == "sh" and re.search("^mgsgraph ", block.text, re.M)}


@pytest.mark.parametrize("page", sorted(WITH_COMMANDS - TABLES - {"README.md"}))
def test_a_page_with_commands_shows_what_comes_out(page: str) -> None:
    printed = [block for block in BLOCKS if block.page == page and block.language in {"output", "none"}]
    assert printed or "```{figure}" in (ROOT / page).read_text(encoding="utf-8")


def of_mgsgraph(words: Sequence[str], comment: str) -> None:
    """Arguments and options that the verb takes; options that its comment names in [brackets] or after PROG too."""
    if words[:1] in ([], ["--help"], ["--version"]):
        return
    with click.Context(group, info_name="mgsgraph") as whole:
        command: click.Command | None = group.get_command(whole, words[0])
        if isinstance(command, click.Group):
            words = words[1:]
            command = command.get_command(whole, words[0])
        assert command is not None, words[0]
        shown = [word for word in words[1:] if not word.startswith("[")]  # [--snoop]: may be said
        comment += " ".join(word for word in words[1:] if word.startswith("["))
        if shown[-1:] == ["..."]:  # more of the option before it
            shown = shown[:-2]
        command.make_context(words[0], shown, parent=whole)
        known = {name for option in command.params for name in (*option.opts, *option.secondary_opts)}
        named = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", comment))
    assert named <= known | {"--help"}, f"{words[0]} has no {named - known}"


def of_pip(words: Sequence[str], comment: str) -> None:
    for extras in re.findall(r"\[(.+?)\]", " ".join(words)):
        assert set(extras.split(",")) <= set(EXTRAS)


def of_python(words: Sequence[str], comment: str) -> None:
    if words[0] == "-m":
        return
    script = (ROOT / words[0]).read_text(encoding="utf-8")
    for option in (word for word in words if word.startswith("--")):
        assert f'"{option}"' in script, f"{words[0]} has no {option}"


def of_dask(words: Sequence[str], comment: str) -> None:
    (verb,) = entry_points(group="dask_cli", name=words[0])
    verb.load().make_context(words[0], list(words[1:]))


def of_sphinx(words: Sequence[str], comment: str) -> None:
    assert (ROOT / words[-2] / "conf.py").exists()


PROGRAMS: dict[str, Callable[[Sequence[str], str], None]] = {
    "mgsgraph": of_mgsgraph,
    "pip": of_pip,
    "python": of_python,
    "python3": of_python,
    "dask": of_dask,
    "sphinx-build": of_sphinx,
    "jq": lambda words, comment: None,  # not ours, and not everywhere
}
"""How the commands of a program are checked."""
TOO_LONG = {"report", "studio"}
"""Verbs of the tutorial that are left to tests of their own; the studio serves until it is ended."""


@pytest.mark.slow
def test_the_tutorial_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """As it stands, but for the figures and the registration by relief (tests/cli/test_simulate.py)."""
    monkeypatch.chdir(tmp_path)
    done = []
    for block in BLOCKS:
        if block.page == "docs/tutorial.md" and block.language == "sh":
            for words, _ in commands_in(block):
                if words[1] not in TOO_LONG:
                    shorter = {"demo": ["--no-figures", "--no-relief"], "adjust": ["--no-figures"]}.get(words[1], [])
                    status = group.main([*words[1:], *shorter], standalone_mode=False)
                    assert not status, words
                    done.append(words[1])
    said = capsys.readouterr().out
    assert {"demo", "analyze", "check", "adjust", "export"} <= set(done)
    assert "MOLA against MOC" in said
    assert "--no-relief" in said
    told = (DOCS / "tutorial.md").read_text(encoding="utf-8")
    by_relief = {"coregistration.json", "profiles.csv", "shots.csv"}
    for file in set(re.findall(r"`(\w+\.(?:csv|json|npz))`", told)) - by_relief:
        places = [tmp_path / "mgsgraph-demo", tmp_path / "mgsgraph-demo" / "inputs"]
        assert any((place / file).exists() for place in places), file


# --- TOML, tables


def as_candidates(table: dict[str, Any]) -> None:
    from mgsgraph.planning.candidates_file import CandidatesInput

    msgspec.convert(table, CandidatesInput)


def as_settings(table: dict[str, Any]) -> None:
    from mgsgraph.project.settings import ProjectSettings

    assert table.pop("format") == 1
    msgspec.convert(table, ProjectSettings)


def as_case(table: dict[str, Any]) -> None:
    """An excerpt leaves out what every case has."""
    from mgsgraph.case.schema import CaseInput

    msgspec.convert({"format": 1, "name": "part of a case", "images": [{"name": "ANY"}], **table}, CaseInput)


TOML: dict[str, Callable[[dict[str, Any]], None]] = {
    "docs/projects.md": as_settings,
    "docs/plan.md": as_candidates,
}
"""What the files of a page are; cases on all others."""


@pytest.mark.parametrize("block", in_language("toml"))
def test_toml_blocks_are_what_the_schema_takes(block: Block) -> None:
    for text in (block.text, uncommented(block.text)):
        TOML.get(block.page, as_case)(tomllib.loads(textwrap.dedent(text)))


def uncommented(text: str) -> str:
    """With the keys that stand behind a # taken in, in a table of their own place; those in the way of others left."""
    lines = []
    for line in text.splitlines():
        key = re.match(r"# (\w+) = ", line)
        taken = key and re.search(rf"^{key[1]} = ", text, re.MULTILINE)
        lines.append(line[2:] if key and not taken else line)
    return "\n".join(lines)


def a_table(text: str, folder: Path) -> None:
    from mgsgraph.files.networks.table import read_table

    (folder / "points.csv").write_text(text, encoding="utf-8")
    assert read_table(folder / "points.csv").points


def verdicts(text: str, folder: Path) -> None:
    from mgsgraph.export.verdicts import read_verdicts

    (folder / "verdicts.csv").write_text(text, encoding="utf-8")
    assert read_verdicts(folder / "verdicts.csv").of


TEXTS: dict[str, Callable[[str, Path], None]] = {"docs/exchange.md": a_table, "docs/matching.md": verdicts}
"""Readers of a page's files."""


@pytest.mark.parametrize("block", in_language("text"))
def test_texts_are_files_that_can_be_read(block: Block, tmp_path: Path) -> None:
    TEXTS[block.page](block.text, tmp_path)


# --- links, names


def anchors(path: Path) -> set[str]:
    """Of the headings, as GitHub and MyST make them."""
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    heads = re.findall(r"^#+ +(.+?) *$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(path: Path) -> None:
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"https?://", target):
            continue
        file, _, anchor = target.partition("#")
        there = (path.parent / file).resolve() if file else path
        assert there.exists(), f"{target}: no such file"
        assert not anchor or anchor in anchors(there), f"{target}: no such heading"


def test_pages_that_are_named_are_there() -> None:
    for path in [*PAGES, *(ROOT / "mgsgraph").rglob("*.py")]:
        for page in re.findall(r"\bdocs/(\w+\.md)\b", path.read_text(encoding="utf-8")):
            assert (DOCS / page).exists(), f"{path}: docs/{page}"


@pytest.mark.parametrize("package", [mgsgraph, mgsgraph.simulation], ids=lambda package: package.__name__)
def test_the_api_page_has_every_public_name(package: ModuleType) -> None:
    pattern = rf"\.\. auto\w+:: {re.escape(package.__name__)}\.(\w+)$"
    assert sorted(re.findall(pattern, (DOCS / "api.md").read_text(encoding="utf-8"), re.MULTILINE)) == package.__all__


def test_functions_of_the_api_page_are_public() -> None:
    named = re.findall(r"\.\. autofunction:: (\S+)\.\w+$", (DOCS / "api.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert set(named) == {"mgsgraph", "mgsgraph.factors", "mgsgraph.simulation"}


@pytest.mark.parametrize("block", in_language("python"))
def test_examples_import_public_names_alone(block: Block) -> None:
    packages = (mgsgraph, mgsgraph.factors, mgsgraph.simulation)
    public = {one.__name__: {*one.__all__, "factors"} for one in packages}
    for node in ast.walk(ast.parse(textwrap.dedent(block.text))):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("mgsgraph"):
            assert {one.name for one in node.names} <= public.get(str(node.module), set()), node.module
        elif isinstance(node, ast.Import):
            assert not [one.name for one in node.names if one.name.startswith("mgsgraph.") and one.name not in public]


def test_pages_about_the_program_are_as_the_program_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "scripts")
    written = importlib.util.spec_from_file_location("pages", ROOT / "scripts" / "pages.py")
    assert written is not None
    assert written.loader is not None
    pages = importlib.util.module_from_spec(written)
    written.loader.exec_module(pages)
    for path, text in pages.pages().items():
        assert path.read_text(encoding="utf-8") == text, "write it anew: python scripts/pages.py"


THEORY = ("theory", "theory_common", "estimation", "api")


def theory() -> str:
    """All pages of the theory."""
    return "".join((DOCS / f"{page}.md").read_text(encoding="utf-8") for page in THEORY)


def test_modules_that_the_theory_names_are_there() -> None:
    text = theory()
    named = re.findall(r"`((?:factors|kernel|geometry|network|adjustment|matching|io)/[\w/]+)`", text)
    assert len(named) > 30
    for name in named:
        base = ROOT if name.startswith("factors/") else ROOT / "mgsgraph"
        assert (base / f"{name}.py").exists() or (base / name).is_dir(), name


def test_the_theory_links_each_equation_to_functions_that_are_there() -> None:
    text = theory()
    rows = re.findall(r"^\| (?:\{eq\}`(\w+)` )?\| `([\w/]+)` \| (.+) \|$", text, re.MULTILINE)
    assert {label for label, _, _ in rows if label} == set(re.findall(r"^\$\$ \((\w+)\)$", text, re.MULTILINE))
    for _, file, functions in rows:
        base = ROOT if file.startswith("factors/") else ROOT / "mgsgraph"
        body = ast.parse((base / f"{file}.py").read_text(encoding="utf-8")).body
        named = {node.name for node in body if isinstance(node, ast.FunctionDef)}
        named |= {
            f"{node.name}.{part.name}"
            for node in body if isinstance(node, ast.ClassDef)
            for part in node.body if isinstance(part, ast.FunctionDef)
        }  # fmt: skip
        assert set(re.findall(r"`([\w.]+)`", functions)) <= named, file


# --- messages of docs/faq.md: those of a small case are provoked, the parts of the others stand in the sou


ROOT = Path(__file__).resolve().parents[1]
MESSAGES = dict(
    re.findall(r"^### (.+)\n```output\n(.+)\n```$", (ROOT / "docs/faq.md").read_text(encoding="utf-8"), re.MULTILINE)
)
OTHERS = {
    "A file is missing": "nothing.toml: no such file; check the path; those in a case file begin at its folder",
    "No format": "data/case.toml: no key 'format'; expected format = 1; write it at the head of the case file",
    "OpenCV is not there": 'matching: OpenCV is not installed; pip install "mgsgraph[match]"',
    "No such point, no such image": "image SIMA: no such image among 2; expected one of their names, e.g. SIM/A, SIM/B",
    "No project there": "nowhere: no such project; make one with: mgsgraph project init nowhere",
    "Not a result": "other: a folder with neither solution.npz nor project.sqlite; "
    "expected results of `mgsgraph adjust`, or a project",
    "A column is unknown": "points.csv, line 1: an unknown column 'sampel'; "
    "expected names of columns in the first line; rename it to 'sample'; …",
    "A value is of the wrong kind": "data/case.toml, line 20, ties.sigma_px: 'one'; "
    "expected a number; all keys: mgsgraph new --keys",
    "The folder is taken": "other: exists and is not a result of mgsgraph; choose another --out",
    "A cube without tables": "E0200665.cub: no table …; "
    "expected the tables of spiceinit; run spiceinit on the cube (attach=yes), or name the label and its kernels",
    "No leap seconds": "E0200665.img, start time …: SPICE says: …; load a leapseconds kernel",
}
"""Messages that say all; no page repeats them."""
MESSAGES |= OTHERS
CHANGED = {
    "A key is unknown": ("sigma_px", "sigm_px"),
    "A value is of the wrong kind": ("sigma_px = 1.0", 'sigma_px = "one"'),
    "No format": ("format = 1\n", ""),
    "No image has the network's name": ('name = "SIM/A"', 'name = "SIM/X"'),
    "No measures at all": ('[ties]\nnetwork = "network.pvl"\nsigma_px = 1.0\n', ""),
    "The network is underdetermined": ("m = 30.0\nangle_sigma_mrad = 0.1", "m = inf\nangle_sigma_mrad = inf"),
}  # fmt: skip
"""What is changed in the case before it is adjusted."""
ASKED = {
    "A file is missing": "adjust nothing.toml --out NEW",
    "No pixels": "match data/case.toml --out NEW",
    "A column is unknown": "convert points.csv x.net",
    "The folder is taken": "adjust data/case.toml --out other",
    "Not a result": "analyze other",
    "No such point, no such image": "analyze RESULT --pose SIMA 10",
    "Rays that miss each other": "analyze RESULT --pixel SIM/A 100 100 --pixel SIM/B 900 900",
    "No project there": "project solve nowhere",
}
"""What is asked for, beside the case and its result."""


@pytest.fixture(scope="module")
def folder(pair_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("faq")
    case = Path(shutil.copytree(pair_folder, here / "data")) / "case.toml"
    (here / "other").mkdir()
    (here / "other" / "mine.txt").touch()
    (here / "points.csv").write_text("id,image,line,sampel\nA,SIM/A,1,1\n", encoding="utf-8")
    assert call("adjust", case, "--no-figures", "--out", here / "RESULT") == 0
    return here


def as_said(message: str) -> str:
    """The pattern of a message; folders are not said alike, nor is what follows from the simulation."""
    parts = re.split(r"…|\b\d+\b(?= sigmas| unknowns)|\b[0-9a-f]{16}\b", message)
    return ".*".join(re.escape(part) for part in parts)


@pytest.mark.parametrize("heading", CHANGED)
def test_a_case_that_is_not_right(heading: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    good = Path("data/case.toml").read_text(encoding="utf-8")
    assert CHANGED[heading][0] in good
    case = Path("data/changed.toml")
    case.write_text(good.replace(*CHANGED[heading]), encoding="utf-8")
    said = refusal("adjust", case, "--no-laser", "--no-figures", "--out", "NEW").replace("changed.toml", "case.toml")
    assert re.fullmatch(f".*{as_said(MESSAGES[heading])}", said)


@pytest.mark.parametrize("heading", ASKED)
def test_what_cannot_be_done(heading: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    said = refusal(*ASKED[heading].split()).replace("data/", "")
    assert re.fullmatch(as_said(MESSAGES[heading].replace("data/", "")), said)


@pytest.fixture(scope="module")
def sources() -> str:
    """All texts of the program, … for what is put in."""
    return "\n".join(text for path in (ROOT / "mgsgraph").rglob("*.py") for text in texts_of(path))


def texts_of(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(one.value) if isinstance(one, ast.Constant) else "…" for one in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


@pytest.mark.parametrize("heading", sorted({*MESSAGES} - {*CHANGED} - {*ASKED}))
def test_every_part_of_a_message_stands_in_the_sources(heading: str, sources: str) -> None:
    where, _, rest = MESSAGES[heading].partition(": ")
    parts = [one.removeprefix("expected ") for one in re.split(r"; |: |, as do |\. |…", rest or where)]
    missing = [one for one in parts if one.strip(" .,()") not in sources]
    assert not missing
