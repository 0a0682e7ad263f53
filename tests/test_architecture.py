"""The house rules of design.md, read from the source with `ast`: who may import whom, sizes, docstrings, habits."""

from __future__ import annotations

import ast
import functools
import graphlib
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

import gyrocal.errors
from gyrocal.cli import COMMANDS
from gyrocal.errors import EXIT_CODES, GyrocalError, exit_code
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.drive import DRIVE_CATALOGUE

PACKAGE = Path(__file__).parents[1] / "gyrocal"
MODULES = sorted(PACKAGE.rglob("*.py"))

_BASE = {"units", "errors", "extensions", "workers"}
_TOOLS = {"physics", "fusion", "records"}
_EXPERTS = {"bench", "inference", "calibration", "navigation", "diagnosis", "planning", "trial"}
#: design.md, "Rooms": room -> rooms that it may import (its own always).
MAY_IMPORT: dict[str, set[str]] = {
    "units": set(),
    "errors": set(),
    "extensions": {"errors"},
    "workers": set(),
    "physics": _BASE,
    "fusion": _BASE | {"physics"},
    # The keys of the robot file are the fields that the runtime takes.
    "records": _BASE | {"fusion"},
    "bench": _BASE | {"records", "physics"},
    "inference": _BASE,
    "calibration": _BASE | _TOOLS | {"inference"},
    "navigation": _BASE | _TOOLS | {"inference"},
    "diagnosis": _BASE | _TOOLS | {"inference", "calibration", "navigation"},
    "planning": _BASE | _TOOLS | {"inference", "calibration", "diagnosis", "bench"},
    "trial": _BASE | _TOOLS | {"inference", "calibration", "diagnosis", "bench", "planning"},
    "report": _BASE | _TOOLS | {"calibration", "navigation", "diagnosis", "trial"},
    "commands": _BASE | _TOOLS | _EXPERTS | {"report"},
    "cli": _BASE | _TOOLS | _EXPERTS | {"report", "commands"},
}
#: What each room may take from outside the package, beside the standard library; None: any dependency.
LIGHT_ROOMS: dict[str, set[str]] = {
    "units": set(),
    "errors": set(),
    "extensions": set(),
    "workers": set(),
    "physics": {"numpy", "numba"},
    "fusion": {"numpy", "numba"},
}
#: Only the clock sleeps.
MAY_SLEEP = {"gyrocal.bench.clock"}
#: The old global generator of numpy, and that of the standard library.
GLOBAL_RANDOM = {
    f"{module}.{name}"
    for module in ("np.random", "numpy.random", "random")
    for name in (
        "seed",
        "random",
        "rand",
        "randn",
        "randint",
        "normal",
        "uniform",
        "choice",
        "shuffle",
        "permutation",
    )
}
#: What the top level of a command's file may import: everything else waits until the command runs.
CLI_TOP_LEVEL = {"click", "gyrocal", "gyrocal.errors", "gyrocal.cli"}


def module_name(path: Path) -> str:
    """Dotted name of a source file of the package."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room(name: str) -> str:
    """Second part of a dotted name; empty for ``gyrocal`` itself."""
    parts = name.split(".")
    return parts[1] if len(parts) > 1 else ""


@functools.cache
def tree_of(path: Path) -> ast.Module:
    """Parsed source."""
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


@functools.cache
def nodes_of(path: Path) -> list[ast.AST]:
    """Every node of the parsed source."""
    return list(ast.walk(tree_of(path)))


def imports(nodes: Iterator[ast.AST], module: str, is_package: bool) -> Iterator[tuple[int, str]]:
    """``(line, dotted name)`` of everything imported by `nodes`, relative imports resolved."""
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parent = module.split(".")[: None if is_package and node.level == 1 else -node.level]
                base = ".".join([*parent, base]).rstrip(".")
            if base == "gyrocal":
                for alias in node.names:
                    yield node.lineno, f"gyrocal.{alias.name}"
            else:
                yield node.lineno, base


def is_type_checking(node: ast.AST) -> bool:
    """Whether `node` is ``if TYPE_CHECKING:``."""
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)


def runtime_nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes but those under ``if TYPE_CHECKING:``."""
    for child in ast.iter_child_nodes(tree):
        if is_type_checking(child):
            continue
        yield child
        yield from runtime_nodes(child)


def top_level_nodes(tree: ast.Module) -> Iterator[ast.AST]:
    """Nodes that run when the module is imported."""
    for child in tree.body:
        if is_type_checking(child):
            continue
        yield child
        if isinstance(child, ast.If | ast.Try):
            yield from ast.walk(child)


def imports_of(path: Path) -> list[tuple[int, str]]:
    """Everything a source file imports, wherever in it."""
    return list(imports(runtime_nodes(tree_of(path)), module_name(path), path.name == "__init__.py"))


def numba_is_optional(path: Path) -> bool:
    """Whether every import of numba in the file stands under ``try`` or ``suppress(ImportError)``."""
    guards = [
        t
        for t in nodes_of(path)
        if isinstance(t, ast.Try)
        or (isinstance(t, ast.With) and "suppress(ImportError)" in ast.unparse(t.items[0]))
    ]
    guarded = {id(n) for t in guards for n in ast.walk(t)}
    for node in nodes_of(path):
        names = list(imports(iter([node]), module_name(path), False))
        if any(name.split(".")[0] == "numba" for _, name in names) and id(node) not in guarded:
            return False
    return True


def definitions(path: Path) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef]:
    """Every function and class of a source file, nested ones included."""
    for node in nodes_of(path):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node


def public_definitions(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Public functions and classes of a module, and the public methods of its public classes."""
    for node in body:
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            continue
        if node.name.startswith("_"):
            continue
        yield node
        if isinstance(node, ast.ClassDef):
            yield from public_definitions(node.body)


def each(paths: Sequence[Path]) -> Callable[[Callable[[Path], None]], Callable[[], None]]:
    """A test that holds a rule against each of these files, and tells of all that break it."""

    def over(rule: Callable[[Path], None]) -> Callable[[], None]:
        def test() -> None:
            broken = []
            for path in paths:
                try:
                    rule(path)
                except AssertionError as error:
                    broken.append(str(error))
            assert not broken, "\n".join(broken)

        return test

    return over


def modules_in(*rooms: str) -> list[Path]:
    """Modules of these rooms."""
    return [p for p in MODULES if room(module_name(p)) in rooms]


@each(MODULES)
def test_import_table(path: Path) -> None:
    name = module_name(path)
    here = room(name)
    allowed = {"cli"} if here in ("", "__main__") else MAY_IMPORT[here] | {here}
    for line, imported in imports_of(path):
        if imported.split(".")[0] == "gyrocal" and room(imported) not in ("", "__version__"):
            assert room(imported) in allowed, f"{path}:{line}: {here or name} may not import {imported}"


def test_the_readme_tells_the_rooms() -> None:
    readme = (PACKAGE.parent / "README.md").read_text(encoding="utf-8")
    told = dict(re.findall(r"^\| `(\w+)` \| .* \| (.*?) ?\|$", readme, re.MULTILINE))
    above: set[str] = set()
    for name, rooms in told.items():
        said = above if rooms == "all above" else set(filter(None, rooms.split(", ")))
        assert said == MAY_IMPORT[name] - _BASE, (
            f"README, rooms: {name} may import {sorted(MAY_IMPORT[name] - _BASE)}"
        )
        above = above | {name}
    assert set(told) == MAY_IMPORT.keys() - _BASE


def test_no_module_imports_itself_in_a_circle() -> None:
    known = {module_name(p): p for p in MODULES}
    graph: dict[str, set[str]] = {}
    for name, path in known.items():
        graph[name] = set()
        for node in nodes_of(path):
            for _, base in imports(iter([node]), name, path.name == "__init__.py"):
                names = [a.name for a in node.names] if isinstance(node, ast.ImportFrom) else []
                parts = {f"{base}.{n}" for n in names} & known.keys()
                graph[name] |= parts or ({base} & known.keys())
    graphlib.TopologicalSorter(graph).prepare()


@each(modules_in(*LIGHT_ROOMS))
def test_light_rooms_need_numpy_only(path: Path) -> None:
    allowed = LIGHT_ROOMS[room(module_name(path))] | {"gyrocal"} | set(sys.stdlib_module_names)
    for line, imported in imports_of(path):
        assert imported.split(".")[0] in allowed, f"{path}:{line}: imports {imported}"
    assert numba_is_optional(path), f"{path}: numba must be imported under try"


CLI = modules_in("cli")


@each(CLI)
def test_command_files_are_thin(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").count("\n")
    assert lines < 150, f"{path}: {lines} lines; a command is options, one library call, render"
    for line, imported in imports_of(path):
        assert imported.split(".")[0] != "numpy", f"{path}:{line}: no numpy in cli"


@each(CLI)
def test_commands_import_late(path: Path) -> None:
    nodes = top_level_nodes(tree_of(path))
    for line, imported in imports(nodes, module_name(path), path.name == "__init__.py"):
        light = imported in CLI_TOP_LEVEL or imported.startswith("gyrocal.cli.")
        light |= imported.split(".")[0] in sys.stdlib_module_names
        assert light, f"{path}:{line}: import {imported} inside the command"


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys\nfrom gyrocal.cli import gyrocal_command\n"
        "try:\n    gyrocal_command(['--help'])\nexcept SystemExit:\n    pass\n"
        "print(','.join(sorted({m.split('.')[0] for m in sys.modules})), file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stderr.strip().split(","))
    assert "click" in loaded
    heavy = {"numpy", "scipy", "pandas", "matplotlib", "numba", "jinja2", "rich", "serial"}
    assert not loaded & heavy
    for command in COMMANDS:
        assert command in done.stdout


def test_runtime_needs_neither_scipy_nor_pandas() -> None:
    code = "import sys, gyrocal.fusion\nprint(','.join(sorted({m.split('.')[0] for m in sys.modules})))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.strip().split(","))
    assert "numpy" in loaded
    assert not loaded & {"scipy", "pandas", "matplotlib", "click", "rich", "jinja2"}


def test_runtime_is_small() -> None:
    lines = sum(p.read_text(encoding="utf-8").count("\n") for p in (PACKAGE / "fusion").glob("*.py"))
    assert lines < 1850, f"gyrocal.fusion has {lines} lines; a robot imports it, so it stays under 1,850"


@each(MODULES)
def test_sizes(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").count("\n")
    assert lines <= 500, f"{path}: {lines} lines"
    for node in definitions(path):
        if not isinstance(node, ast.ClassDef):
            length = (node.end_lineno or node.lineno) - node.lineno + 1
            assert length <= 60, f"{path}:{node.lineno}: {node.name} has {length} lines"


@each(MODULES)
def test_public_things_have_docstrings(path: Path) -> None:
    tree = tree_of(path)
    assert ast.get_docstring(tree), f"{path}: no module docstring"
    for node in public_definitions(tree.body):
        assert isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        assert ast.get_docstring(node), f"{path}:{node.lineno}: {node.name} has no docstring"


@pytest.mark.parametrize(
    "folder",
    [
        "diagnosis",
        *(f"diagnosis/{p.parent.name}" for p in sorted((PACKAGE / "diagnosis").glob("*/__init__.py"))),
    ],
)
def test_a_large_folder_says_in_which_order_to_read_it(folder: str) -> None:
    told = ast.get_docstring(tree_of(PACKAGE / folder / "__init__.py")) or ""
    for path in (PACKAGE / folder).glob("*.py"):
        assert path.stem == "__init__" or f"{path.stem}`" in told or f"`{path.stem}." in told, (
            f"{folder}/__init__.py: say in the docstring what {path.name} is for"
        )


@each(MODULES)
def test_habits(path: Path) -> None:
    name = module_name(path)
    for node in nodes_of(path):
        where = f"{path}:{getattr(node, 'lineno', 0)}"
        assert not isinstance(node, ast.Assert), f"{where}: assert vanishes under python -O; raise"
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            assert called != "print", f"{where}: print; use click.echo in cli"
            if name not in MAY_SLEEP:
                assert called not in ("time.sleep", "sleep"), f"{where}: pass in a clock"
            assert called not in GLOBAL_RANDOM, (
                f"{where}: {called} is global random state; pass in a Generator"
            )
        if isinstance(node, ast.ExceptHandler):
            assert node.type is not None, f"{where}: bare except"


def holds_a_number(value: ast.AST) -> bool:
    """Whether a number stands anywhere in an expression but as an index."""
    if isinstance(value, ast.Subscript):
        return False
    own = isinstance(value, ast.Constant) and type(value.value) in (int, float)
    return own or any(map(holds_a_number, ast.iter_child_nodes(value)))


def constants(path: Path) -> Iterator[ast.Assign]:
    """Numbers, alone or several, that stand by a name in capitals at the top of a module."""
    for node in tree_of(path).body:
        if isinstance(node, ast.Assign) and holds_a_number(node.value):
            names = {n.id for n in ast.walk(node.targets[0]) if isinstance(n, ast.Name)}
            if all(name.isupper() for name in names):
                yield node


@each(modules_in("diagnosis", "inference"))
def test_constants_give_their_reason(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    for node in constants(path):
        above = lines[node.lineno - 2]
        assert above.startswith("#:"), f"{path}:{node.lineno}: say in a line '#: ...' above why this number"


@each(MODULES)
def test_nothing_unfinished(path: Path) -> None:
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        for word in ("TODO", "FIXME", "XXX", "NotImplementedError"):
            assert word not in line, f"{path}:{number}: {line.strip()}"


#: Words that are ids of effects and something else beside, by module: keys of files, figures of merit, states of a filter.
SAME_WORD = {
    "gyrocal.calibration.figures": {"thermal_hysteresis"},
    "gyrocal.calibration.noise": {"quantisation"},
    "gyrocal.fusion.coefficients": {"rate_order", "temperature_order"},
    "gyrocal.navigation.simulate": {"gyro_scale"},
    "gyrocal.planning.planned": {"rate_order", "temperature_order"},
}
#: What the truth of a drive is asked for: parameters of its path, that effects are named after.
OF_A_PATH = {"gyro_scale", "wheel_scale"}
SAME_WORD |= {
    "gyrocal.diagnosis.drive.findings": OF_A_PATH,
    "gyrocal.diagnosis.drive.improved": OF_A_PATH,
    "gyrocal.diagnosis.drive.reckoning": {"wheel_scale"},
    "gyrocal.diagnosis.drive.path_laid": OF_A_PATH,
    "gyrocal.diagnosis.drive.truth": {"gyro_scale"},
}
#: The blind trial writes its laws itself, so as to share no formula with the finder, and says which names are right.
OWN_LAWS = {"gyrocal.trial.laws": set(CATALOGUE) - {"quantisation", "time_base", "rate_heating"}}


def ids_in(path: Path) -> set[str]:
    """Ids of effects that stand as text in a module."""
    known = set(CATALOGUE) | set(DRIVE_CATALOGUE)
    texts = {n.value for n in nodes_of(path) if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    return texts & known


@each([p for p in MODULES if room(module_name(p)) != "physics"])
def test_only_physics_knows_an_effect(path: Path) -> None:
    """What a module has to know of an effect it asks its object; where one is meant, it is imported."""
    name = module_name(path)
    allowed = SAME_WORD.get(name, set()) | OWN_LAWS.get(name, set())
    assert ids_in(path) <= allowed, f"{path}: ask the effect's object, or import it from gyrocal.physics"


def test_the_exceptions_are_needed() -> None:
    for name, words in (SAME_WORD | OWN_LAWS).items():
        path = PACKAGE.parent.joinpath(*name.split(".")).with_suffix(".py")
        assert words <= ids_in(path), f"{name}: {sorted(words - ids_in(path))} stand there no longer"


#: What reads a recording, fits or tests: `gyrocal.commands` calls it, and gives what came of it to `gyrocal.report`.
ENGINES = {
    "calibrate",
    "calibrate_turns",
    "compare_runs",
    "compile_dossier",
    "examine",
    "examine_static",
    "find_outliers",
    "fit_chosen",
    "gather",
    "iterate_gyro_log",
    "load_coefficients",
    "load_recording",
    "measure_fleet",
    "noise_figures",
    "read_columns",
    "read_data_sets",
    "read_drive",
    "read_limits",
    "read_robot",
    "read_run",
    "scatter_by_rate",
    "umbmark",
    "unit_run",
    "diagnose",
    "diagnose_drive",
    "versus",
    "drive_versus",
    "propose",
    "replay_log",
    "monte_carlo",
    "run_trials",
    "run_made_up",
    "acquire",
    "simulate_to_directory",
}


@each(modules_in("report"))
def test_report_runs_nothing(path: Path) -> None:
    for node in nodes_of(path):
        if isinstance(node, ast.ImportFrom):
            called = {a.name for a in node.names} & ENGINES
            assert not called, f"{path}:{node.lineno}: {sorted(called)} belongs to gyrocal.commands"


#: Where a sentence stands in the rooms of statistics: remedies of errors, equations, and the text of a program that is written.
SENTENCES = {
    "gyrocal.diagnosis.rows.inputs",
    "gyrocal.diagnosis.versus.answer",
    "gyrocal.diagnosis.versus.law_file",
}
#: A text of so many words is a sentence.
_WORDS = 6


def sentences_in(path: Path) -> Iterator[tuple[int, str]]:
    """Sentences that a module holds beside docstrings and what it raises."""
    raised = {id(n) for r in nodes_of(path) if isinstance(r, ast.Raise) for n in ast.walk(r)}
    alone = {id(n.value) for n in nodes_of(path) if isinstance(n, ast.Expr)}
    for node in nodes_of(path):
        if not (isinstance(node, ast.Constant) and isinstance(node.value, str)):
            continue
        if id(node) not in raised | alone and len(node.value.split()) >= _WORDS:
            yield node.lineno, node.value


@each(modules_in("diagnosis", "inference"))
def test_sentences_are_made_at_the_edge(path: Path) -> None:
    found = list(sentences_in(path))
    if module_name(path) in SENTENCES:
        assert found, f"{module_name(path)}: is no exception any longer"
        return
    for line, text in found:
        raise AssertionError(f"{path}:{line}: {text!r}: answer with a remark, and say it in gyrocal.report")


def error_classes() -> list[type[GyrocalError]]:
    """Every error class of errors.py but the base."""
    found = vars(gyrocal.errors).values()
    return [c for c in found if isinstance(c, type) and issubclass(c, GyrocalError) and c is not GyrocalError]


def messages(path: Path) -> list[tuple[int, str]]:
    """Constant text of every error raised in a source file, with its line."""
    found = []
    names = {cls.__name__ for cls in EXIT_CODES}
    for node in nodes_of(path):
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and node.func.id in names
            and node.args
        ):
            text = "".join(
                part.value if isinstance(part, ast.Constant) and isinstance(part.value, str) else "…"
                for part in (
                    node.args[0].values if isinstance(node.args[0], ast.JoinedStr) else [node.args[0]]
                )
            )
            if text != "…":
                found.append((node.lineno, text))
    return found


@each(MODULES)
def test_error_texts_are_sentences(path: Path) -> None:
    for line, text in messages(path):
        assert text.rstrip().endswith((".", "…", ")")), (
            f"{path}:{line}: {text!r} does not end like a sentence"
        )
        assert "\n" not in text, f"{path}:{line}: an error is one line"


def test_every_error_has_its_own_exit_code() -> None:
    assert set(error_classes()) == set(EXIT_CODES)
    codes = list(EXIT_CODES.values())
    assert len(codes) == len(set(codes)), "two errors share an exit code"
    # 0 is success, 1 a bug, 2 click's usage error.
    assert not set(codes) & {0, 1, 2}
    assert exit_code(GyrocalError("x")) == 1


@pytest.mark.parametrize("cls", error_classes())
def test_an_error_ends_with_its_exit_code(cls: type[GyrocalError]) -> None:
    assert exit_code(cls("x")) == EXIT_CODES[cls]


def test_error_classes_live_in_one_place() -> None:
    names = {c.__name__ for c in error_classes()}
    for path in MODULES:
        if path.name == "errors.py" and path.parent == PACKAGE:
            continue
        for node in definitions(path):
            bases = [ast.unparse(b).split(".")[-1] for b in getattr(node, "bases", ())]
            assert names.isdisjoint(bases), f"{path}:{node.lineno}: define errors in errors.py"
