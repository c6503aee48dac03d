"""The command line as a person uses it, in processes of its own: exit status, one line on stderr, nothing left over."""

import io
import json
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import click
import pytest
from commands import COMMAND, call, refusal, refused, run, run_afresh
from hypothesis import given
from hypothesis import strategies as st
from numba.core import event
from tqdm import tqdm

import mgsgraph
from mgsgraph import compiled
from mgsgraph.cli import group, options, progress
from mgsgraph.cli.options import PrintableStream
from mgsgraph.cli.verbs import VERBS


@pytest.mark.parametrize("arguments", [("--help",), ("adjust", "-h"), ("--version",)])
def test_help(arguments: tuple[str, ...]) -> None:
    done = run_afresh(*arguments)
    assert done.returncode == 0
    assert done.stdout.strip()
    assert not done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("qqq",), "adjust, align, batch"),
        (("adjsut",), "mean 'adjust'?"),
        (("adjust",), "CASE"),
        (("coregister", "CASE"), "mgsgraph align"),
        (("help", "case"), "mgsgraph new --keys"),
        (("solve", "PROJECT"), "mgsgraph project solve"),
        (("project", "RESULT", "IMAGE", "--pixel", "1", "2"), "mgsgraph locate"),
        (("project", "slove", "PROJECT"), "mean 'solve'?"),
        (("align", "x.toml", "--reach", "9"), "'--reach'; --search"),
        (("adjust", "x.toml", "--out", "y", "--loss", "l1"), "huber"),
        (("check", "a", "b"), "b"),
        (("fetch", "M04/02852", "--verify"), "No such option '--verify'; the same fetch again holds the folder"),
    ],
)
def test_typing_errors_show_the_way(arguments: tuple[str, ...], said: str) -> None:
    done = run(*arguments)
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr


def test_adjust_writes_everything(case_file: Path, tmp_path: Path) -> None:
    """Slow: the one test of a new process that draws all its figures, with every warning an error."""
    out = tmp_path / "result"
    done = run_afresh("adjust", case_file, "--out", out, "-v")
    assert done.returncode == 0, done.stderr
    names = {path.name for path in out.iterdir()}
    assert {"solution.json", "points.csv", "orientation.csv", "residuals.csv", "solution.npz"} <= names
    assert any(name.endswith(".png") for name in names)
    record = json.loads((out / "solution.json").read_text(encoding="utf-8"))
    assert record["status"] == "converged"
    assert "sigma0" in done.stdout
    assert " m" in done.stdout
    solution = mgsgraph.read_solution(out)
    assert solution.cost_final == pytest.approx(record["cost_final"], rel=1e-12)
    again = run("adjust", case_file, "--out", out, "--no-figures")
    assert again.returncode == 0, again.stderr
    assert not any(path.suffix == ".png" for path in out.iterdir())
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


@pytest.mark.parametrize("options", [("--loss", "huber"), ("--reject", "5"), ("--no-laser",)])
def test_options(case_file: Path, tmp_path: Path, options: tuple[str, ...]) -> None:
    done = run("adjust", case_file, "--out", tmp_path / "result", "--no-figures", *options)
    assert done.returncode == 0, done.stderr
    solution = mgsgraph.read_solution(tmp_path / "result")
    if options[0] == "--no-laser":
        assert solution.network.ranges.point.size == 0
        assert "prior" in done.stdout
    else:
        wanted = {options[0][2:]: float(options[1]) if options[0] == "--reject" else options[1]}
        assert all(getattr(solution.settings, name) == value for name, value in wanted.items())


def test_check_tells_what_is_there(case_file: Path, tmp_path: Path) -> None:
    before = sorted(path.name for path in case_file.parent.iterdir())
    assert len(run("check", case_file, cwd=tmp_path).stdout.splitlines()) <= 15
    done = run("check", case_file, "--details", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for said in ("SIM/A", "SIM/B", "8 laser ranges", "Connections", "Warnings"):
        assert said in done.stdout
    assert re.findall(r"^  (tie|laser) +(\d+)", done.stdout, re.MULTILINE) == [("tie", "20"), ("laser", "8")]
    assert sorted(path.name for path in case_file.parent.iterdir()) == before


def test_bad_input_leaves_no_folder(case_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "result"
    text = case_file.read_text(encoding="utf-8")
    case_file.write_text(text.replace("sigma_px = 1.0", "sigma_px = -1.0"), encoding="utf-8")
    refused(run("adjust", case_file, "--out", out), "sigma_px")
    refused(run("adjust", tmp_path / "none.toml", "--out", out), "no such file")
    refused(run("check", tmp_path), "a folder")
    assert not out.exists()
    assert [path.name for path in tmp_path.iterdir()] == ["case"]


def test_a_foreign_folder_is_not_replaced(case_file: Path, tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "thesis.txt").write_text("years of work", encoding="utf-8")
    refused(run("adjust", case_file, "--out", precious), "not a result of mgsgraph")
    assert (precious / "thesis.txt").read_text(encoding="utf-8") == "years of work"
    out = tmp_path / "result"
    assert run("adjust", case_file, "--out", out, "--no-figures").returncode == 0
    (out / "notes.txt").write_text("mine", encoding="utf-8")
    refused(run("adjust", case_file, "--out", out, "--no-figures"), "notes.txt")
    assert (out / "notes.txt").read_text(encoding="utf-8") == "mine"


def test_a_datum_that_nothing_holds_is_named(case_file: Path, tmp_path: Path) -> None:
    text = case_file.read_text(encoding="utf-8")
    text = text.replace("position_sigma_m = 30.0", "position_sigma_m = inf").replace(
        "angle_sigma_mrad = 0.1", "angle_sigma_mrad = inf"
    )
    case_file.write_text(text, encoding="utf-8")
    done = run("adjust", case_file, "--out", tmp_path / "result", "--no-laser")
    refused(done, "underdetermined")
    assert "SIM/" in done.stderr
    assert not (tmp_path / "result").exists()
    done = run("check", case_file, "--no-laser")
    assert done.returncode == 0, done.stderr
    assert "underdetermined" in done.stdout


@pytest.mark.program("bash")
def test_a_full_disk(case_file: Path, tmp_path: Path) -> None:
    """/dev/full answers every write with ENOSPC; a file size limit does the same to any file."""
    limited = f"ulimit -f 8; exec {' '.join(COMMAND)} adjust {case_file} --out {tmp_path / 'result'} --no-figures"
    done = subprocess.run(["bash", "-c", limited], capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["case"]


def test_not_converged_is_exit_status_one(case_file: Path, tmp_path: Path) -> None:
    text = case_file.read_text(encoding="utf-8") + "\n[solver]\nmax_iterations = 1\n"
    case_file.write_text(text, encoding="utf-8")
    done = run("adjust", case_file, "--out", tmp_path / "result", "--no-figures")
    assert done.returncode == 1
    assert "max_iterations" in done.stdout


def test_a_full_standard_output() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([*COMMAND, "--help"], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    refused(done, "standard output")


def catches(process: subprocess.Popen[str], number: signal.Signals) -> bool:
    """Whether a process has a handler of its own for a signal (or has ended)."""
    status = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii")
    caught = dict(line.split(":\t", 1) for line in status.splitlines()).get("SigCgt", "0")
    return process.poll() is not None or bool(int(caught, 16) >> (number - 1) & 1)


@pytest.mark.parametrize("wait", [0.0, 1.7])
def test_an_interrupt_leaves_nothing(case_file: Path, tmp_path: Path, wait: float) -> None:
    """While libraries are imported, and while it adjusts or writes; not before the program has begun."""
    command = [*COMMAND, "adjust", str(case_file), "--out", str(tmp_path / "result")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not catches(process, signal.SIGTERM):  # Python itself has one for SIGINT
        time.sleep(0.01)
    time.sleep(wait)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=120)
    assert "Traceback" not in errors
    if process.returncode != 0:
        assert process.returncode == 130
        assert sorted(path.name for path in tmp_path.iterdir()) == ["case"]


_INTERRUPTED_IN_A_FINALIZER = """
import signal, sys, time
import click
from mgsgraph import cli

class Finalized:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

def work():
    Finalized()
    time.sleep(30.0)

cli.group = click.Command("work", callback=work)
sys.argv = ["mgsgraph"]
cli.main()
"""


_SWALLOWED = """
    try:
        signal.raise_signal(signal.SIGINT)
    except BaseException:
        pass
"""


@pytest.mark.parametrize("lost", ["    Finalized()\n", _SWALLOWED])
def test_an_interrupt_is_not_lost(lost: str) -> None:
    """Python can't raise it in a finalizer, and would print a traceback and go on; a library may swallow it."""
    program = _INTERRUPTED_IN_A_FINALIZER.replace("    Finalized()\n", lost)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=20)
    assert done.returncode == 130
    assert "Traceback" not in done.stderr


_CLEANING_UP = """
import signal, sys, time
import click
from mgsgraph import cli

def work():
    try:
        signal.raise_signal(signal.SIGINT)
    finally:
        time.sleep(0.7)
        print("cleaned up", flush=True)

cli.group = click.Command("work", callback=work)
sys.argv = ["mgsgraph"]
cli.main()
"""


def test_what_cleans_up_behind_an_interrupt_is_let_do_so() -> None:
    done = subprocess.run([sys.executable, "-c", _CLEANING_UP], capture_output=True, text=True, check=False, timeout=20)
    assert (done.returncode, done.stdout) == (130, "cleaned up\n")


def test_what_imports_make_is_not_searched_for_garbage() -> None:
    """Which takes a tenth of a short command's time."""
    code = "import gc; from mgsgraph.cli import main\ntry: main()\nfinally: print(gc.get_threshold()[0])"
    done = subprocess.run([sys.executable, "-c", code, "--version"], capture_output=True, text=True, check=True)
    assert int(done.stdout.split()[-1]) >= 100_000


def test_names_that_are_no_text_are_refused(tmp_path: Path) -> None:
    """Bytes that are no UTF-8 came as half a character to the first record that should hold the name."""
    code = "import sys; sys.argv[1:] = ['check', 'a\\udcff']; from mgsgraph.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "no UTF-8" in done.stderr


@pytest.mark.program("bash")
def test_too_little_memory_for_the_libraries_is_said_before_they_are_loaded(case_file: Path) -> None:
    """With 512 MB, OpenBLAS or numba would spin, and heed no signal."""
    command = ["bash", "-c", 'ulimit -v 512000; exec "$@"', "bash", *COMMAND, "check", str(case_file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=20)
    refused(done, "ulimit -v")


@pytest.mark.program("bash")
def test_too_few_open_files_are_named_before_any_kernel_is(case_file: Path) -> None:
    command = ["bash", "-c", 'ulimit -n 8; exec "$@"', "bash", *COMMAND, "check", str(case_file)]
    refused(subprocess.run(command, capture_output=True, text=True, check=False), "ulimit -n")


_FAILING = r"""
import sys
import click
from mgsgraph import cli

def work():
    print("a\x1b[2J\u202e\udc80z")
    raise {raised}

cli.group = click.Command("work", callback=work)
sys.argv = ["mgsgraph"]
cli.main()
"""


@pytest.mark.parametrize(
    ("raised", "said"),
    [(r"OSError(5, 'Input/output error', 'a\x1b.img')", "a\\x1b.img"), ("OSError('odd')", "odd"),
     ("type('error', (Exception,), {'code': -4})()", "memory")],
)  # fmt: skip
def test_stray_errors_name_their_file_and_output_is_printable(raised: str, said: str) -> None:
    program = _FAILING.format(raised=raised)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=20)
    refused(done, said)
    assert done.stderr.strip().isprintable()
    assert "standard output" not in done.stderr
    assert done.stdout == "" or done.stdout.strip().isprintable()


def test_a_loss_that_forgets_blunders_converges(case_file: Path, tmp_path: Path) -> None:
    """From the nominal orientation, without a tie less."""
    done = run("adjust", case_file, "--out", tmp_path / "result", "--no-figures", "--loss", "tukey")
    assert done.returncode == 0, done.stdout
    assert mgsgraph.read_solution(tmp_path / "result").rays_used.all()


# --- words while something is under way: they are said where they are true


KIND = "numba:compile"


@pytest.fixture(autouse=True)
def _hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "_EXPLAIN_AFTER", 0.02)
    monkeypatch.setattr(progress, "_INTERVAL", 0.01)
    compiled._watch_compiler()


def test_a_slow_machine_compiles_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.word_of_compiling():
        time.sleep(0.08)
    with progress.iteration_bar():
        time.sleep(0.08)
    assert "compil" not in capsys.readouterr().err


def test_what_numba_compiles_is_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.word_of_compiling(), event.trigger_event(KIND):
        assert compiled.is_compiling()
        time.sleep(0.15)
    assert not compiled.is_compiling()
    assert capsys.readouterr().err.count("compiling") == 1


def test_a_bar_tells_how_long_shrinking_steps_will_take(monkeypatch: pytest.MonkeyPatch) -> None:
    said, clock = list[str](), iter(range(0, 1000, 10))
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    bar = progress.IterationBar(False)
    monkeypatch.setattr(bar.bar, "set_postfix_str", lambda text, refresh: said.append(text))
    for step in (1.0, 1e-2, 1e-4, 1e-7):
        bar(SimpleNamespace(cost=2.0, step=step))  # type: ignore[arg-type]
    assert [re.findall(r"about (\d+) s", text) for text in said] == [[], ["10"], ["7"], []]


# --- what is printed: at most 15 lines, all of them by -v, which is one option


@given(st.lists(st.lists(st.sampled_from("ab"), max_size=12), max_size=5), st.integers(0, 4), st.booleans())
def test_no_more_than_fifteen_lines_without_details(tables: list[list[str]], more: int, every: bool) -> None:
    """The first lines, none of a table of which less than six would be left; the last says how many are not."""
    lines = [line for table in tables for line in ("", *table)][1:] or ["a"]
    with patch.object(options, "details", lambda: every), patch.object(options.click, "echo") as echo:
        options.print_brief(*lines, more=more)
    shown = echo.call_args.args[0].split("\n")
    if every or len(lines) + more <= 15:
        assert shown == lines
        return
    *kept, last = shown
    assert len(shown) + more <= 15
    assert kept == lines[: len(kept)]
    assert last.split()[0] == str(len(lines) - len(kept))
    assert lines[len(kept)] == "" or "" not in kept[-6:]


def test_details_are_one_option() -> None:
    with click.Context(group) as whole:
        names = [verb.split() for verb in VERBS]
        commands = [group.get_command(whole, name) for name, *_ in names]
        found = [one if len(name) == 1 else one.get_command(whole, name[1])
                 for name, one in zip(names, commands, strict=True)]  # fmt: skip
        params = [[one for one in command.params if "-v" in one.opts] for command in found]
        has = dict(zip(VERBS, params, strict=True))
    assert len({(*one.opts, one.help) for several in has.values() for one in several}) == 1
    assert {verb for verb, several in has.items() if not several} == {
        "fetch", "simulate", "new", "locate", "studio", "project init", "export"
    }  # fmt: skip


# --- what goes to a terminal: names out of files can't move its cursor, and our own bars can


def test_one_bar_in_another_moves_up() -> None:
    stream = io.StringIO()
    said = PrintableStream(stream, "standard error")
    for _ in tqdm(range(2), file=said, mininterval=0.0):
        for _ in tqdm(range(2), file=said, mininterval=0.0, leave=False):
            pass
    assert "\\x1b" not in stream.getvalue()
    assert "\n\r" in stream.getvalue()
    assert "\x1b[A" in stream.getvalue()


def test_names_move_nothing() -> None:
    stream = io.StringIO()
    said = PrintableStream(stream, "standard error")
    for text in ("a\x1b[A", "\x1b[Ab", "\x1b[2A", "\x1b[A\r", "\x1b[B", "\x1b[A\x1b[2J"):
        said.write(text)
    assert "\x1b" not in stream.getvalue()


# --- without --out, by parts of names, and what helps where a verb is given something else


def test_results_lie_in_folders_named_after_case_and_verb(
    case_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    named = case_file.rename(case_file.with_name("pair.toml"))
    call("adjust", named, "--no-figures")
    call("export", "pair-adjust", "--to", "csm,isis")
    call("export", "pair-adjust/solution.npz", "--to", "isis, csm", "--out", "both", "--scaled")
    assert {path.name for path in tmp_path.iterdir()} == {
        "case", "pair-adjust", "pair-adjust-csm", "pair-adjust-isis", "both"
    }  # fmt: skip
    scaled = [json.loads(path.read_text())["scaled"] for path in sorted(Path("both").glob("*/export.json"))]
    assert [path.name for path in sorted(Path("both").iterdir())] == ["csm", "isis"]
    assert scaled == [False, True]
    assert "it with spice alone" in refusal("export", "pair-adjust", "--to", "csm,isis", "--verify")
    assert "'doc'" in refusal("export", "pair-adjust", "--to", "csm,doc")


def test_a_part_of_an_image_s_name_is_enough(solved: Path, tmp_path: Path) -> None:
    project = Path(shutil.copytree(solved, tmp_path / "project"))
    call("analyze", project, "--pose", "/A", 10, "--projection", "TIE00001", "/B")
    for arguments in (("analyze", project, "--pose", "SIM", 10), ("project", "remove", project, "SIM")):
        assert re.search("SIM: a part of 2 names.* SIM/A, SIM/B$", refusal(*arguments))
    call("project", "measure", project, "TIE00001", "--reject", "/B")
    call("project", "remove", project, "/B")
    with mgsgraph.open_project(project) as opened:
        assert opened.store.image_names() == ["SIM/A"]
        assert [one.what for one in opened.changes()][-1] == "SIM/B"


def test_remedies_name_the_verb_that_serves(solved: Path, case_file: Path) -> None:
    text = case_file.read_text(encoding="utf-8")
    head, _, rest = text.partition("[ties]")
    case_file.write_text(head + rest[rest.index("\n[") :], encoding="utf-8")
    for verb, remedy in {
        ("adjust", solved): f"mgsgraph project solve {solved}",
        ("project", "solve", case_file): f"mgsgraph project init PROJECT --case {case_file}",
        ("adjust", case_file, "--no-laser"): f"mgsgraph match {case_file}",
    }.items():
        assert remedy in refusal(*verb)
