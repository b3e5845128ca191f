"""The shape of the house: what may import what, and what every file must have."""

import ast
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "identifiability"

# A module imports from its own layer and from those before it; layers in one row do not know each
# other.
LAYERS = (
    ("errors",),
    ("files", "loops", "numerals", "progress", "provenance", "palette"),
    ("sweep",),
    ("measurement",),
    ("joint",),
    ("inference",),
    ("study", "investigation"),
    ("benchmark",),
    ("plots",),
    ("report", "workbench"),
    ("cli",),
)
RANK = {name: rank for rank, row in enumerate(LAYERS) for name in row}
PRESENTATION = {"plots", "report", "workbench", "cli"}


def module_name(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


TREES = {
    module_name(path): ast.parse(path.read_text(encoding="utf-8"))
    for path in sorted((ROOT / PACKAGE).rglob("*.py"))
}


def layer_of(module):
    return module.split(".")[1] if "." in module else ""


def under_type_checking(tree):
    """Nodes that only type checkers see."""
    return {
        id(node)
        for branch in ast.walk(tree)
        if isinstance(branch, ast.If) and "TYPE_CHECKING" in ast.unparse(branch.test)
        for node in ast.walk(branch)
    }


def imports(tree, *, for_types=True):
    """Modules that a file imports anywhere, functions included."""
    hidden = set() if for_types else under_type_checking(tree)
    for node in ast.walk(tree):
        if id(node) in hidden:
            continue
        if isinstance(node, ast.Import):
            yield from ((alias.name, node) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: a relative import"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield (inner if inner in TREES else node.module), node


def at_import(tree):
    """Modules that are imported when the file is, not when one of its functions runs."""
    inside = {
        id(node)
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef)
        for node in ast.walk(function)
    }
    return [m for m, node in imports(tree, for_types=False) if id(node) not in inside]


def own(module):
    return module == PACKAGE or module.startswith(f"{PACKAGE}.")


def test_there_is_a_package():
    assert {"errors", "measurement", "joint", "inference"} <= {layer_of(m) for m in TREES}


@pytest.mark.parametrize("module", TREES)
def test_imports_follow_the_layers(module):
    layer = layer_of(module)
    if not layer or layer == "__main__":
        return
    assert layer in RANK, f"{module} belongs to no layer"
    for imported, node in imports(TREES[module]):
        if not own(imported):
            continue
        other = layer_of(imported)
        assert other, f"{module}, line {node.lineno}, imports the package's root"
        assert other == layer or RANK[other] < RANK[layer], (
            f"{module}, line {node.lineno}, imports {imported}, which is not below it"
        )


def test_study_and_investigation_do_not_know_each_other():
    assert RANK["study"] == RANK["investigation"]
    for module, tree in TREES.items():
        pair = {"study": "investigation", "investigation": "study"}
        stranger = pair.get(layer_of(module))
        assert all(not own(m) or layer_of(m) != stranger for m, _ in imports(tree))


def test_no_import_cycles():
    graph = {module: set() for module in TREES}
    for module, tree in TREES.items():
        for imported in at_import(tree):
            if not own(imported):
                continue
            # Importing a.b.c runs a and a.b first; a module's own parents are running already.
            parts = imported.split(".")
            for depth in range(1, len(parts) + 1):
                parent = ".".join(parts[:depth])
                if parent in TREES and not f"{module}.".startswith(f"{parent}."):
                    graph[module].add(parent)
    seen, path = set(), []

    def visit(module):
        assert module not in path, " -> ".join([*path[path.index(module) :], module])
        if module in seen:
            return
        path.append(module)
        for imported in sorted(graph[module]):
            visit(imported)
        path.pop()
        seen.add(module)

    for module in graph:
        visit(module)


# Rooms of the investigation, as the layers above: those in one row do not know each other.
ROOMS = (
    ("rules",),
    ("pieces",),
    ("split",),
    ("fits",),
    ("where", "unexplained"),
    ("posterior",),
    ("ladder", "smallest_seen"),
    ("verdict",),
    ("next_experiment", "rivals"),
    ("findings",),
    ("models",),
    ("session",),
    ("across",),
    ("wording",),
    ("record",),
    ("investigate",),
)
ROOM_RANK = {name: rank for rank, row in enumerate(ROOMS) for name in row}


def room_of(module):
    """Its room, if a module is part of the investigation."""
    inside = module.removeprefix(f"{PACKAGE}.investigation.")
    return inside.split(".")[0] if inside != module else ""


@pytest.mark.parametrize("module", [m for m in TREES if room_of(m)])
def test_rooms_of_the_investigation_follow_their_order(module):
    room = room_of(module)
    assert room in ROOM_RANK, f"{module} belongs to no room"
    for imported, node in imports(TREES[module]):
        other = room_of(imported)
        assert not other or other == room or ROOM_RANK[other] < ROOM_RANK[room], (
            f"{module}, line {node.lineno}, imports {imported}, which is not below it"
        )


@pytest.mark.parametrize("module", TREES)
def test_matplotlib_only_in_plots(module):
    if layer_of(module) == "plots":
        return
    drawing = {"matplotlib", "corner", "seaborn"}
    # Views draw on axes that they are handed: they know their type, and no more.
    for_types = room_of(module) != "where"
    found = [m for m, _ in imports(TREES[module], for_types=for_types)]
    found = [m for m in found if m.split(".")[0] in drawing]
    assert not found, f"{module} imports {found}"


def test_presentation_is_imported_by_nobody():
    for module, tree in TREES.items():
        if layer_of(module) in PRESENTATION or not layer_of(module) or layer_of(module)[0] == "_":
            continue
        assert not [m for m, _ in imports(tree) if own(m) and layer_of(m) in PRESENTATION]


@pytest.mark.parametrize("module", [m for m in TREES if layer_of(m) == "cli"])
def test_the_command_line_starts_without_heavy_imports(module):
    for imported in at_import(TREES[module]):
        if own(imported):
            assert layer_of(imported) in {"cli", "errors", "files", "progress"}, imported
        else:
            assert imported.split(".")[0] in sys.stdlib_module_names, imported


def test_subcommands_share_options_and_not_each_other():
    """The command line flows one way too; only the demonstration runs what it demonstrates."""
    shared = {f"{PACKAGE}.cli.{name}" for name in ("options", "exits", "clock", "workers")}
    for module, tree in TREES.items():
        if layer_of(module) != "cli" or module.endswith((".main", ".demo")):
            continue
        inside = {m for m, _ in imports(tree) if m.startswith(f"{PACKAGE}.cli")}
        assert inside <= shared, module
        assert not (module in shared and inside), module


# Documentation


def public_definitions(tree):
    """Public classes and functions of a module, and public methods of its public classes."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
            yield node, None
            if isinstance(node, ast.ClassDef):
                for member in node.body:
                    if isinstance(member, ast.FunctionDef) and not member.name.startswith("_"):
                        yield member, node


CLASSES = {
    node.name: node
    for tree in TREES.values()
    for node in ast.walk(tree)
    if isinstance(node, ast.ClassDef)
}


def documented(function, owner):
    """Whether a method, or the one that it overrides, has a docstring."""
    if ast.get_docstring(function):
        return True
    for base in owner.bases if owner else ():
        parent = CLASSES.get(ast.unparse(base).split(".")[-1].split("[")[0])
        if parent is None:
            continue
        for member in parent.body:
            if isinstance(member, ast.FunctionDef) and member.name == function.name:
                return documented(member, parent)
    return False


@pytest.mark.parametrize("module", TREES)
def test_everything_public_is_documented(module):
    tree = TREES[module]
    assert ast.get_docstring(tree), f"{module} has no docstring"
    for node, owner in public_definitions(tree):
        if isinstance(node, ast.ClassDef):
            assert ast.get_docstring(node), f"{module}.{node.name} has no docstring"
        else:
            assert documented(node, owner), f"{module}, line {node.lineno}: {node.name}"


@pytest.mark.parametrize("module", TREES)
def test_every_function_is_annotated(module):
    methods = {
        id(member)
        for node in ast.walk(TREES[module])
        if isinstance(node, ast.ClassDef)
        for member in node.body
        if isinstance(member, ast.FunctionDef)
        and not any(ast.unparse(d) == "staticmethod" for d in member.decorator_list)
    }
    for node in ast.walk(TREES[module]):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        taken = [*node.args.posonlyargs, *node.args.args]
        if id(node) in methods:
            taken = taken[1:]
        taken += [*node.args.kwonlyargs, node.args.vararg, node.args.kwarg]
        where = f"{module}, line {node.lineno}: {node.name}"
        assert all(arg.annotation for arg in taken if arg), where
        assert node.returns or node.name == "__init__", where


# Small rules


@pytest.mark.parametrize("module", TREES)
def test_only_the_command_line_prints(module):
    if layer_of(module) == "cli":
        return
    calls = [n for n in ast.walk(TREES[module]) if isinstance(n, ast.Call)]
    assert not [c.lineno for c in calls if isinstance(c.func, ast.Name) and c.func.id == "print"]


@pytest.mark.parametrize("module", TREES)
def test_random_numbers_come_from_a_seed(module):
    if module == "identifiability.benchmark.peers":
        return  # one of them knows the global generator alone, which is put back after it
    calls = [ast.unparse(n.func) for n in ast.walk(TREES[module]) if isinstance(n, ast.Call)]
    stateful = r"(np|numpy)\.random\.(?!default_rng|SeedSequence|Generator|RandomState|MT19937)"
    assert not [call for call in calls if re.match(stateful, call)]
    for node in ast.walk(TREES[module]):
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("random.default_rng"):
            assert node.args, f"{module}, line {node.lineno}: no seed"


@pytest.mark.parametrize("module", TREES)
def test_no_bare_asserts_on_input(module):
    """An assertion may narrow a type; it must not be what stands between a user and a mistake."""
    for node in ast.walk(TREES[module]):
        if isinstance(node, ast.Assert):
            assert "is not None" in ast.unparse(node.test) or "isinstance" in ast.unparse(
                node.test
            ), f"{module}, line {node.lineno}"


TEXTS = (
    sorted(
        path
        for folder in (PACKAGE, "tests", "notebooks")
        for path in (ROOT / folder).rglob("*")
        if path.suffix in {".py", ".md", ".toml", ".ipynb", ".html", ".js", ".css"}
        and not any(part.startswith(".") for part in path.relative_to(ROOT).parts)
    )
    + sorted(ROOT.glob("*.md"))
    + sorted(ROOT.glob("*.toml"))
)


def test_nothing_is_left_to_be_done():
    words = ("TO" + "DO", "FIX" + "ME", "X" * 3)
    for path in TEXTS:
        # Pictures in notebooks spell anything.
        text = re.sub(r'"image/png": "[^"]*"', "", path.read_text(encoding="utf-8"))
        assert not [word for word in words if re.search(rf"\b{word}\b", text)], path


def test_no_machines_path_is_committed():
    homes = re.compile("/" + "(?:home|Users|root|work|tmp)/[A-Za-z]")
    for path in TEXTS:
        found = homes.search(path.read_text(encoding="utf-8"))
        assert not found, f"{path}: {found.group()}"


@pytest.mark.parametrize("path", sorted((ROOT / "tests").glob("*.py")), ids=lambda path: path.stem)
def test_no_test_module_imports_another(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert not [m for m, _ in imports(tree) if m.split(".")[0].startswith("test_")]
